"""What the C library does with memory that arrays have given back: keep it for the next arrays."""

from __future__ import annotations

import ctypes
import platform
from functools import cache

KEPT_BYTES = 64 * 1024 * 1024
"""Freed memory that a process keeps at most; the arrays of a tile or of a batch of poses take a few megabytes."""

MAPPED_BYTES = 32 * 1024 * 1024
"""Size from which on an array gets pages of its own, which go back at once: the largest that glibc takes."""

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Names of parameters in glibc's malloc.h."""


@cache
def keep_freed_memory() -> None:
    """Let this process keep the memory of arrays for those that follow, instead of giving it back to the system.

    A tile makes hundreds of arrays of some 100 kB, each of them for a moment. glibc gives so much back as soon as it
    is free, at the latest in a Dask worker, whose nanny sets MALLOC_TRIM_THRESHOLD_ to 64 kB; the system then clears
    each page again for the next array, which took more of the processor than the computation. Where the C library is
    another one nothing is done.
    """
    if platform.libc_ver()[0] != "glibc":
        return
    library = ctypes.CDLL(None)
    library.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
    library.mallopt(M_MMAP_THRESHOLD, MAPPED_BYTES)

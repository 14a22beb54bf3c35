"""Memory behind which none can be read, so that a test notices who reads beyond."""

from __future__ import annotations

import ctypes
import mmap


def at_the_edge(size: int, contents: bytes = b"") -> memoryview:
    """Return so many bytes of memory, in front of a page that cannot be read; they begin with some contents."""
    page = mmap.mmap(-1, 2 * mmap.PAGESIZE)
    behind = ctypes.addressof(ctypes.c_char.from_buffer(page)) + mmap.PAGESIZE
    assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(behind), mmap.PAGESIZE, 0) == 0
    memory = memoryview(page)[mmap.PAGESIZE - size : mmap.PAGESIZE]
    memory[: len(contents)] = contents
    return memory

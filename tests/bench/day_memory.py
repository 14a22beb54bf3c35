"""What a process holds: its resident memory, Python's objects, and what hangs on one of them."""

from __future__ import annotations

import gc
import os
import types
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

PASSED_BY = (type, types.ModuleType, types.BuiltinFunctionType, types.FrameType)
"""What holds the program itself."""
CONTAINERS = (list, dict, set, frozenset, tuple, deque)


def resident_bytes() -> int:
    """Return the resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def objects() -> int:
    """Return how many objects Python's collector knows, when it has collected."""
    gc.collect()
    return len(gc.get_objects())


def _referents(one: Any) -> list[Any]:
    """Return what an object holds; a function holds what it is made over, not its module."""
    return list(one.__closure__ or ()) if isinstance(one, types.FunctionType) else gc.get_referents(one)


def holdings(root: Any, *but: Any) -> Counter[str]:
    """Return how many elements the containers hold that hang on an object but not behind others, by type."""
    found: Counter[str] = Counter()
    seen, waiting = {id(one) for one in (root, *but)}, [root]
    while waiting:
        one = waiting.pop()
        if isinstance(one, CONTAINERS):
            found[type(one).__name__] += len(one)
        for other in _referents(one):
            if id(other) not in seen and not isinstance(other, PASSED_BY):
                seen.add(id(other))
                waiting.append(other)
    return found


def slope(hours: Sequence[float], values: Sequence[float]) -> float:
    """Return how much a value grows in an hour, by least squares."""
    return float(np.polyfit(hours, values, 1)[0]) if len(hours) > 1 else 0.0

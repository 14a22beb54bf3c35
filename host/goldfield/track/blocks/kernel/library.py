"""The library in C of the block filter, if it has been built (``setup.py``), and how arrays are handed to it."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

DECLARATIONS = """
size_t gf_bank_size(void);
void gf_bank_init(void *, uint32_t, const double *);
void gf_bank_start(void *, const double *, const double *);
bool gf_bank_update(void *, const double *, const double *, const double *, double, double, double *);
void gf_bank_predict(void *, double);
void gf_bank_output(const void *, double, double *, double *, double *, double *);
typedef struct {
    size_t beacons;
    const double *field, *gradient, *rotation, *velocity, *rate, *ambient, *offset, *covariance;
} gf_moving_t;
typedef struct {
    const double *gram, *moment, *sums;
} gf_block_sums_t;
void gf_rest(const gf_moving_t *, const gf_block_sums_t *, double *, double *, double *, double *, double *, double *);
size_t gf_cost_memory(size_t);
bool gf_cost(size_t, size_t, const double *, const double *, const double *, const double *, double, double *,
             double *);
typedef struct {
    size_t beacons, heard;
    const int64_t *rows;
    size_t measured;
    const int64_t *axes;
    const double *field, *jacobian, *rotation;
    size_t errors;
    const double *effects, *variance;
} gf_watched_t;
size_t gf_watch_memory(size_t, size_t, size_t);
void gf_watch(const gf_watched_t *, size_t, const double *, double, double *, double *);
typedef struct {
    const double *position, *rotation, *velocity, *rate, *covariance;
} gf_estimate_t;
bool gf_apart(const gf_estimate_t *, const gf_estimate_t *, double, double *, double *);
void gf_between(const gf_estimate_t *, const gf_estimate_t *, const double *, double, double *, double *);
typedef struct {
    double even_T, gradient_T_m, settling_T_s, fastest_m_s, certain, likely, better;
} gf_even_limits_t;
typedef struct {
    const double *rotation, *velocity, *offset, *covariance;
} gf_attitude_t;
void gf_even(const gf_even_limits_t *, const gf_attitude_t *, const double *, double, double *, double *);
"""

ffi: Any = cffi.FFI()
ffi.cdef(DECLARATIONS)
_DOUBLES, _NUMBERS = ffi.typeof("double[]"), ffi.typeof("int64_t[]")


@cache
def opened() -> Any | None:
    """Return the library that ``setup.py`` puts into the folder ``built`` here, None if there was no compiler."""
    path = Path(__file__).with_name("built") / "libgf_bank.so"
    return ffi.dlopen(str(path)) if path.exists() else None


def given(array: NDArray[np.float64]) -> Any:
    """Return an array for C to read."""
    return ffi.from_buffer(_DOUBLES, np.ascontiguousarray(array, dtype=np.float64))


def numbers(array: NDArray[np.intp]) -> Any:
    """Return an array of indices for C to read."""
    return ffi.from_buffer(_NUMBERS, np.ascontiguousarray(array, dtype=np.int64))


def filled(array: NDArray[np.float64]) -> Any:
    """Return an array for C to write."""
    return ffi.from_buffer(_DOUBLES, array, require_writable=True)

"""What the library in C declares (kernel.h), and how arrays are handed to it."""

from __future__ import annotations

from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

from goldfield.types import FloatArray

DECLARATIONS = """
typedef struct {
    double centre_m[3];
    double radius_m;
    size_t degree;
    const double *sums;
    size_t bodies;
    double body_m[8][3];
    const double *moment_A_m2;
} gf_metal_t;
typedef struct {
    size_t count;
    double centre_m[3][64];
    double axis[3][64];
    double moment_A_m2[64];
    double radius_m[64];
    double across[3];
    const gf_metal_t *metal;
} gf_coils_t;
typedef struct {
    double position_sd_m[64];
    double axis_sd_rad[64];
    double current_sd[64];
    double gain_sd;
    double sensor_axis_sd_rad;
    double noise_shape[3][3];
} gf_errors_t;
void gf_evaluate(const gf_coils_t *, size_t, const double *, double *, double *);
size_t gf_starts(const gf_coils_t *, size_t, const double *, const double *, double, double, double, double *,
                 double *);
size_t gf_fit(const gf_coils_t *, const gf_errors_t *, size_t, const double *, const double *, double, size_t, double,
              double *, double *, double *, double *, uint8_t *);
size_t gf_fit_distorted(const gf_coils_t *, size_t, const double *, const double *, double, const double *, size_t,
                        const double *, size_t, double, double *, double *, double *, double *);
void gf_search(const gf_coils_t *, size_t, const double *, const double *, double, const double *, size_t, double, bool,
               double *, double *, uint8_t *, double *, uint32_t *);
typedef struct {
    size_t count;
    const double *field_T;
    const double *sigma_T;
    const double *noise_T;
    size_t starts;
    const double *start_m;
    const double *start_rotation;
    double model_error;
    size_t rough_iterations;
    double rough_tolerance;
    size_t final_iterations;
    double final_tolerance;
    size_t pool;
    double clear_cost;
    double unfit_cost;
    size_t most_evaluations;
} gf_subsets_t;
typedef struct {
    double *position_m;
    double *rotation;
    double *cost;
    double *information;
    uint8_t *converged;
} gf_subset_fits_t;
size_t gf_fit_subsets(const gf_coils_t *, const gf_errors_t *, const gf_subsets_t *, const gf_subset_fits_t *, bool *);
typedef struct {
    double *drop;
    int32_t *freedom;
    double *scale;
    double *separation_m;
    double *separation_cov_m2;
    double *distortion;
    int32_t *distortion_freedom;
} gf_fault_tables_t;
void gf_faults(const gf_coils_t *, const gf_errors_t *, size_t, const double *, const double *, const double *,
               const double *, double, double, const gf_fault_tables_t *);
void gf_covariance(const gf_coils_t *, const gf_errors_t *, size_t, const double *, const double *, const double *,
                   const double *, double, double, double, double *);
"""

ffi: Any = cffi.FFI()
ffi.cdef(DECLARATIONS)
_DOUBLES, _BYTES = ffi.typeof("double[]"), ffi.typeof("uint8_t[]")
_WORDS = {np.dtype(np.int32): ffi.typeof("int32_t[]"), np.dtype(np.uint32): ffi.typeof("uint32_t[]")}


def given(values: FloatArray) -> Any:
    """Return an array for C to read."""
    return ffi.from_buffer(_DOUBLES, np.ascontiguousarray(values, dtype=np.float64))


def filled(values: FloatArray) -> Any:
    """Return an array for C to write."""
    return ffi.from_buffer(_DOUBLES, values, require_writable=True)


def bytes_filled(values: NDArray[np.uint8] | NDArray[np.bool_]) -> Any:
    """Return an array of bytes for C to write."""
    return ffi.from_buffer(_BYTES, values, require_writable=True)


def words_filled(values: NDArray[np.int32] | NDArray[np.uint32]) -> Any:
    """Return an array of numbers of 32 bits for C to write."""
    return ffi.from_buffer(_WORDS[values.dtype], values, require_writable=True)

"""The hot path of location in C, if it has been built (``setup.py``); `of` finds it for a site.

Without the library the NumPy code that each method names computes the same, slower. The equations, the units and the
bounds are in kernel.h.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.field.metal import MetalField
from goldfield.locate.kernel.library import bytes_filled, ffi, filled, given, words_filled
from goldfield.locate.site_errors import SiteErrors
from goldfield.types import FloatArray

MOST_COILS = 64
"""GF_MOST_COILS of kernel.h."""

MOST_SUBSETS = 128
"""GF_MOST_SUBSETS of kernel.h."""

_FAULT_TABLES = ("drop", "freedom", "scale", "separation_m", "separation_cov_m2", "distortion", "distortion_freedom")

_kernels: WeakKeyDictionary[FieldModel, Kernel] = WeakKeyDictionary()
_declared: WeakKeyDictionary[SiteErrors, Any] = WeakKeyDictionary()


@cache
def _library() -> Any | None:
    """Return the library that ``setup.py`` puts into the folder ``built`` here, None if there was no compiler."""
    path = Path(__file__).with_name("built") / "libgf_locate.so"
    return ffi.dlopen(str(path)) if path.exists() else None


def of(model: FieldModel) -> Kernel | None:
    """Return the kernel for these coils; None if it is not built, or for coils given by their wire or too many."""
    library = _library()
    if library is None:
        return None
    known = _kernels.get(model)
    if known is None and 0 < len(model) <= MOST_COILS and not len(model.wire_points_m):
        known = _kernels[model] = Kernel(library, model)
    return known


def evaluate(model: FieldModel, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what ``model.evaluate`` does of real points, shape (3, ...), by the kernel where there is one."""
    quick = of(model)
    return model.evaluate(point_m) if quick is None else quick.evaluate(point_m)


class Kernel:
    """The functions of kernel.h for one set of coils.

    Everywhere: e epochs, n coils; ``field_T``, shape (e, n, 3), NaN where not measured, and ``sigma_T``, shape (e, n).
    With ``errors`` the components are whitened for those of the site and the sensor; ``sigma_T`` is the noise alone.

    Parameters
    ----------
    library
        Opened by cffi.
    model : FieldModel
        Circular coils and dipoles.
    """

    def __init__(self, library: Any, model: FieldModel) -> None:
        self._library = library
        self._coils = ffi.new("gf_coils_t *")
        self._coils.count = len(model)
        size = np.linalg.norm(model.moment_A_m2, axis=1)
        for name, values in (("centre_m", model.centre_m), ("axis", model.moment_A_m2 / size[:, None])):
            for part, row in zip(getattr(self._coils, name), values.T, strict=True):
                part[0 : len(model)] = row.tolist()
        self._coils.moment_A_m2[0 : len(model)] = size.tolist()
        self._coils.radius_m[0 : len(model)] = model.loop_radius_m.tolist()
        self._coils.across[0:3] = model.across.tolist()
        if model.metal is not None:
            self._metal = _metal(model.metal)
            self._coils.metal = self._metal[0]

    def evaluate(self, point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return field and gradient at points as `FieldModel.evaluate` does."""
        shape = (*point_m.shape[1:], self._coils.count)
        field, gradient = np.empty((3, *shape)), np.empty((3, 3, *shape))
        points = point_m.reshape(3, -1).T
        self._library.gf_evaluate(self._coils, len(points), given(points), filled(field), filled(gradient))
        return field, gradient

    def starts(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        *,
        range_error: float,
        magnitude_error: float,
        vector_error: float,
    ) -> tuple[FloatArray, FloatArray, int]:
        """Position and attitude with no prior, from complete vectors: `starts` and `wahba` one after another.

        Returns
        -------
        position_m : ndarray, shape (e, 3)
        rotation : ndarray, shape (e, 3, 3)
        evaluations : int
            How often the field was evaluated in all.
        """
        position, rotation = np.empty((len(field_T), 3)), np.empty((len(field_T), 3, 3))
        evaluations = self._library.gf_starts(
            self._coils,
            len(field_T),
            given(field_T),
            given(sigma_T),
            range_error,
            magnitude_error,
            vector_error,
            filled(position),
            filled(rotation),
        )
        return position, rotation, int(evaluations)

    def fit(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        position_m: FloatArray,
        rotation: FloatArray,
        *,
        errors: SiteErrors | None,
        model_error: float,
        iterations: int,
        tolerance: float,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.bool_], int]:
        """Fit as `fit.fit_pose` does; returns position, attitude, cost, information, converged, evaluations in all."""
        count = len(field_T)
        position, turn = np.array(position_m, dtype=float, order="C"), np.array(rotation, dtype=float, order="C")
        cost, information, converged = np.empty(count), np.empty((count, 6, 6)), np.empty(count, dtype=np.bool_)
        evaluations = self._library.gf_fit(
            self._coils,
            _errors(errors),
            count,
            given(field_T),
            given(sigma_T),
            model_error,
            iterations,
            tolerance,
            filled(position),
            filled(turn),
            filled(cost),
            filled(information),
            bytes_filled(converged),
        )
        return position, turn, cost, information, converged, int(evaluations)

    def fit_subsets(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        noise_T: FloatArray,
        fits: tuple[FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.bool_]],
        start_m: FloatArray,
        start_rotation: FloatArray,
        *,
        errors: SiteErrors | None,
        **options: float,
    ) -> tuple[bool, int]:
        """Compare subsets of one epoch's coils as `exclusion` does.

        Parameters
        ----------
        fits : tuple of ndarray
            Position, attitude, cost, information and convergence of rough fits, which are replaced in place.
        start_m, start_rotation : ndarray, shapes (k, 3) and (k, 3, 3)
            As many starts of each subset, one subset after another; there may be none.
        options
            The other members of ``gf_subsets_t``.

        Returns
        -------
        hopeless : bool
            True if no subset fits even with model error.
        evaluations : int
            How often the field was evaluated in all.
        """
        kept = [np.ascontiguousarray(part) for part in (field_T, sigma_T, noise_T, start_m, start_rotation)]
        subsets, hopeless = ffi.new("gf_subsets_t *", options), ffi.new("bool *")
        subsets.count, subsets.starts = len(field_T), len(start_m) // len(field_T)
        for name, part in zip(("field_T", "sigma_T", "noise_T", "start_m", "start_rotation"), kept, strict=True):
            setattr(subsets, name, given(part))
        *numbers, converged = fits
        out = ffi.new("gf_subset_fits_t *", (*map(filled, numbers), bytes_filled(converged)))
        evaluations = self._library.gf_fit_subsets(self._coils, _errors(errors), subsets, out, hopeless)
        return bool(hopeless[0]), int(evaluations)

    def fit_distorted(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        position_m: FloatArray,
        rotation: FloatArray,
        *,
        fixed: FloatArray,
        basis: FloatArray,
        model_error: float,
        iterations: int,
        tolerance: float,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, int]:
        """Fit a sensor that distorts; returns position, attitude, cost, distortion of shape (e, 3, 3), evaluations.

        The distortion moves from ``fixed``, shape (3, 3), along ``basis``, shape (k, 3, 3); see kernel.h.
        """
        count = len(field_T)
        position, turn = np.array(position_m, dtype=float, order="C"), np.array(rotation, dtype=float, order="C")
        cost, distortion = np.empty(count), np.empty((count, 3, 3))
        evaluations = self._library.gf_fit_distorted(
            self._coils,
            count,
            given(field_T),
            given(sigma_T),
            model_error,
            given(fixed),
            len(basis),
            given(basis),
            iterations,
            tolerance,
            filled(position),
            filled(turn),
            filled(cost),
            filled(distortion),
        )
        return position, turn, cost, distortion, int(evaluations)

    def search(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        *,
        half_space: FloatArray,
        most_evaluations: int,
        hopeless_cost: float = float("inf"),
        at_any_cost: bool = True,
        model_error: float = 0.0,
    ) -> tuple[FloatArray, FloatArray, NDArray[np.intp], FloatArray, NDArray[np.intp]]:
        """Search the best pose of each epoch and a rival with no prior, from complete vectors; see kernel.h.

        Parameters
        ----------
        half_space : ndarray, shape (4,)
            Unit normal of the half-space and the least component along it; zeros allow all positions.
        most_evaluations : int
        hopeless_cost : float
            A descent ends where it costs more, even with a relative error of the model.
        at_any_cost : bool
            Whether the best pose is wanted even if it costs more.

        Returns
        -------
        position_m : ndarray, shape (e, 2, 3)
        rotation : ndarray, shape (e, 2, 3, 3)
            NaN where nothing was found.
        found : ndarray of int, shape (e,)
            How many of the two there are.
        widening : ndarray, shape (e, 6, 6)
            What the covariance of the best lacks because its valley bends.
        evaluations : ndarray of int, shape (e,)
        """
        count = len(field_T)
        position, rotation = np.full((count, 2, 3), np.nan), np.full((count, 2, 3, 3), np.nan)
        found, evaluations = np.empty(count, dtype=np.uint8), np.empty(count, dtype=np.uint32)
        widening = np.empty((count, 6, 6))
        self._library.gf_search(
            self._coils,
            count,
            given(field_T),
            given(sigma_T),
            model_error,
            given(half_space),
            most_evaluations,
            hopeless_cost,
            at_any_cost,
            filled(position),
            filled(rotation),
            bytes_filled(found),
            filled(widening),
            words_filled(evaluations),
        )
        return position, rotation, found.astype(np.intp), widening, evaluations.astype(np.intp)

    def faults(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        position_m: FloatArray,
        rotation: FloatArray,
        *,
        errors: SiteErrors | None,
        least_eigenvalue: float,
        least_share: float,
    ) -> tuple[FloatArray, NDArray[np.intp], FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.intp]]:
        """Return what `fault_statistics.fault_statistics` does, in its order."""
        count, coils = field_T.shape[:2]
        shapes = ((coils,), (coils,), (coils,), (coils, 3), (coils, 3, 3), (4,), (4,))
        kinds = (float, np.int32, float, float, float, float, np.int32)
        tables: list[NDArray[Any]] = [np.empty((count, *k), dtype=t) for k, t in zip(shapes, kinds, strict=True)]
        out = ffi.new("gf_fault_tables_t *")
        for name, table in zip(_FAULT_TABLES, tables, strict=True):
            setattr(out, name, filled(table) if table.dtype == np.float64 else words_filled(table))
        self._library.gf_faults(
            self._coils,
            _errors(errors),
            count,
            given(field_T),
            given(sigma_T),
            given(position_m),
            given(rotation),
            least_eigenvalue,
            least_share,
            out,
        )
        drop, freedom, scale, separation, spread, distortion, distortion_freedom = tables
        return drop, freedom.astype(np.intp), scale, separation, spread, distortion, distortion_freedom.astype(np.intp)

    def covariance(
        self,
        field_T: FloatArray,
        sigma_T: FloatArray,
        position_m: FloatArray,
        rotation: FloatArray,
        *,
        errors: SiteErrors | None,
        least_eigenvalue: float,
        free_m2: float,
        free_rad2: float,
    ) -> FloatArray:
        """Return what `uncertainty.second_order_covariance` does, shape (e, 6, 6)."""
        covariance = np.empty((len(field_T), 6, 6))
        self._library.gf_covariance(
            self._coils,
            _errors(errors),
            len(field_T),
            given(field_T),
            given(sigma_T),
            given(position_m),
            given(rotation),
            least_eigenvalue,
            free_m2,
            free_rad2,
            filled(covariance),
        )
        return covariance


def _errors(errors: SiteErrors | None) -> Any:
    if errors is None:
        return ffi.NULL
    if errors not in _declared:
        declared = ffi.new("gf_errors_t *")
        for name in ("position_sd_m", "axis_sd_rad", "current_sd"):
            values = getattr(errors, name)
            getattr(declared, name)[0 : len(values)] = values.tolist()
        declared.gain_sd, declared.sensor_axis_sd_rad = errors.gain_sd, errors.sensor_axis_sd_rad
        shape = np.eye(3) if errors.noise_shape is None else errors.noise_shape
        declared.noise_shape = shape.tolist()
        _declared[errors] = declared
    return _declared[errors]


def _metal(field: MetalField) -> tuple[Any, Any, Any]:
    """Return a ``gf_metal_t`` and the memory that it points to, which must live as long."""
    metal, out = field.metal, ffi.new("gf_metal_t *")
    sums, moment = given(field.sums), given(field.moment_A_m2)
    out.centre_m[0:3] = metal.centre_m.tolist()
    out.radius_m, out.degree, out.bodies = metal.radius_m, metal.degree, len(metal.body_m)
    for row, place in zip(out.body_m, metal.body_m, strict=False):
        row[0:3] = place.tolist()
    out.sums, out.moment_A_m2 = sums, moment
    return out, sums, moment

"""Whitening: the linear map after which the errors of measured components are independent and of unit variance."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.site_errors import SiteErrors, effects_of_beacons, effects_of_sensor
from goldfield.types import FloatArray


class Whitening(Protocol):
    """What `Independent` and `Correlated` have in common, for e epochs and n beacons."""

    def __call__(self, components: FloatArray) -> FloatArray:
        """Whiten rows of components, shape (e, k, 3, n): to shape (e, k, 3n)."""
        ...

    def tiled(self, times: int) -> Whitening:
        """Return the same for as many copies of the epochs, one after another."""
        ...

    def by_beacon(self, whitened: FloatArray) -> FloatArray:
        """Return what whitened rows, shape (e, k, 3n), see of a fault of each beacon, shape (e, n, 3, k).

        A fault is one of a beacon's own components, whitened by its own covariance alone.
        """
        ...

    def alone(self, components: FloatArray) -> FloatArray:
        """Whiten components, shape (e, 3, n), of each beacon by its own covariance alone, shape (e, n, 3)."""
        ...

    @property
    def gram(self) -> FloatArray:
        """Products of what is seen of the faults of each beacon, shape (e, n, 3, 3): 1 if no sensor mixes beacons."""
        ...


class Independent:
    """Whitening of components with independent errors.

    Attributes
    ----------
    weight : ndarray, shape (e, 3, n)
        Reciprocal standard deviations; 0 where nothing was measured.
    """

    def __init__(self, weight: FloatArray) -> None:
        self.weight = weight

    def __call__(self, components: FloatArray) -> FloatArray:
        """See `Whitening`."""
        return np.asarray((components * self.weight[:, None]).reshape(*components.shape[:2], -1))

    def tiled(self, times: int) -> Independent:
        """See `Whitening`."""
        return Independent(np.tile(self.weight, (times, 1, 1)))

    def by_beacon(self, whitened: FloatArray) -> FloatArray:
        """See `Whitening`."""
        return _by_beacon(whitened)

    def alone(self, components: FloatArray) -> FloatArray:
        """See `Whitening`."""
        return np.asarray((components * self.weight).swapaxes(1, 2))

    @property
    def gram(self) -> FloatArray:
        """See `Whitening`."""
        return np.asarray(np.eye(3) * (self.weight > 0.0).swapaxes(1, 2)[..., None])


class Correlated:
    """Whitening of components with errors of the site and the sensor.

    Attributes
    ----------
    beacon : ndarray, shape (e, n, 3, 3)
        Inverse Cholesky factors of the covariances C_i; rows and columns of zeros where nothing was measured.
    mixing : ndarray, shape (e, 3n, 3n), or None
        Inverse Cholesky factor of I + S S', where S is whitened by ``beacon``: None if the sensor is exact. The n
        beacons' x come first, then their y and z.
    """

    def __init__(self, beacon: FloatArray, mixing: FloatArray | None = None) -> None:
        self.beacon = beacon
        self.mixing = mixing

    def tiled(self, times: int) -> Correlated:
        """See `Whitening`."""
        mixing = None if self.mixing is None else np.tile(self.mixing, (times, 1, 1))
        return Correlated(np.tile(self.beacon, (times, 1, 1, 1)), mixing)

    def take(self, rows: NDArray[np.intp]) -> Correlated:
        """Return some of the epochs."""
        return Correlated(self.beacon[rows], None if self.mixing is None else self.mixing[rows])

    def __call__(self, components: FloatArray) -> FloatArray:
        """See `Whitening`."""
        result = np.einsum("encd,ekdn->ekcn", self.beacon, components).reshape(*components.shape[:2], -1)
        return result if self.mixing is None else np.asarray(result @ self.mixing.swapaxes(1, 2))

    def by_beacon(self, whitened: FloatArray) -> FloatArray:
        """See `Whitening`."""
        return _by_beacon(whitened if self.mixing is None else whitened @ self.mixing)

    def alone(self, components: FloatArray) -> FloatArray:
        """See `Whitening`."""
        return np.asarray(np.einsum("encd,edn->enc", self.beacon, components))

    @property
    def gram(self) -> FloatArray:
        """See `Whitening`."""
        count = self.beacon.shape[1]
        measured = np.einsum("encc->enc", self.beacon) != 0.0
        product = np.eye(3) * measured[..., None]
        if self.mixing is not None:
            blocks = self.mixing.reshape(len(self.mixing), -1, 3, count)
            product = np.einsum("emcn,emdn->encd", blocks, blocks) * (measured[..., None] & measured[..., None, :])
        return np.asarray(product)


def whitening_around(
    model: FieldModel, errors: SiteErrors, noise_T: FloatArray, position_m: FloatArray, rotation: FloatArray
) -> Correlated:
    """Return the whitening of the components of e epochs around their poses.

    Parameters
    ----------
    noise_T : ndarray, shape (e, n, 3)
        Standard deviation of each component by noise alone; infinite where nothing was measured. Where the errors have
        a ``noise_shape``, it comes on top of this.
    position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
    """
    effect, field = effects_of_beacons(model, errors, position_m, kernel.evaluate(model, position_m.T))
    back = rotation.swapaxes(1, 2)[:, None]
    effect = back @ effect
    measured = np.isfinite(noise_T)
    both = measured[..., :, None] & measured[..., None, :]
    covariance = np.where(both, effect @ effect.swapaxes(2, 3), 0.0)
    noise = np.where(measured, noise_T, 1.0)
    covariance += np.eye(3) * noise[..., None] ** 2
    if errors.noise_shape is not None:
        covariance += np.where(both, noise[..., None] * (errors.noise_shape - np.eye(3)) * noise[..., None, :], 0.0)
    factor = np.where(both, _inverse_factor(covariance), 0.0)
    if not (errors.gain_sd or errors.sensor_axis_sd_rad):
        return Correlated(factor)
    shared = factor @ effects_of_sensor(errors, (back @ field[..., None])[..., 0])  # (e, n, 3, 6)
    shared = shared.transpose(0, 2, 1, 3).reshape(len(shared), -1, 6)
    return Correlated(factor, _inverse_factor(np.eye(shared.shape[1]) + shared @ shared.swapaxes(1, 2)))


def _inverse_factor(covariance: FloatArray) -> FloatArray:
    """Return the inverse Cholesky factors of covariances, shape (..., m, m); NaN where one is not finite, on a wire."""
    usable = np.isfinite(covariance).all(axis=(-2, -1), keepdims=True)
    factor = np.linalg.inv(np.linalg.cholesky(np.where(usable, covariance, np.eye(covariance.shape[-1]))))
    return np.where(usable, factor, np.nan)


def _by_beacon(rows: FloatArray) -> FloatArray:
    """Turn (e, k, 3n), components leading, into (e, n, 3, k)."""
    return np.asarray(rows.reshape(*rows.shape[:2], 3, -1).transpose(0, 3, 2, 1))

"""From what the axes of a sensor read to the components of the field in the sensor's frame, and their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.site import SensorSite
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class SensorAxes:
    """Undoes the gains and directions of a sensor's axes; `axes_of` makes one of a site file.

    With readings y = A B of k axes the components are B = A^-1 y. Their noise may differ and be correlated: its
    covariance is ``noise_ratio**2 * noise_shape`` times the (mean) variance of one reading.

    Attributes
    ----------
    inverse : ndarray, shape (3, 3)
        A^-1; the rows of components that no axis reads are NaN.
    count : int
        Number of axes, k.
    noise_ratio : float
        Root mean square of the components' noise over that of the readings.
    noise_shape : ndarray, shape (3, 3)
        Covariance of the components' noise over its mean variance; 1 for what no axis reads.
    """

    inverse: FloatArray
    count: int
    noise_ratio: float
    noise_shape: FloatArray

    def components(self, readings_T: FloatArray) -> FloatArray:
        """Return components in the sensor's frame, of readings, both of shape (..., 3).

        A reading that is missing, NaN, takes with it what it has a part in: with square axes its own component, else
        all of them.
        """
        inverse, known = self.inverse[: self.count, : self.count], readings_T[..., : self.count]
        result = np.full(readings_T.shape, np.nan)
        own = np.diag(inverse)
        square = np.count_nonzero(inverse) == self.count  # no NaN may meet a zero of the matrix
        result[..., : self.count] = known * own if square else known @ inverse.T
        return result

    @property
    def noise_of_each(self) -> FloatArray:
        """Noise of each component over that of a reading, shape (3,)."""
        return np.asarray(self.noise_ratio * np.sqrt(np.diag(self.noise_shape)))


def axes_of(sensor: SensorSite) -> SensorAxes | None:
    """Return what undoes the axes of a site's sensor; None if they read the components as they are, with equal noise.

    Examples
    --------
    >>> axes = axes_of(SensorSite(1e-7, axes=np.diag([1.0, -2.0, 1.0])))
    >>> axes.components(np.array([1e-6, 4e-6, np.nan]))
    array([ 1.e-06, -2.e-06,     nan])
    >>> axes_of(SensorSite(1e-7)) is None
    True
    """
    if sensor.axes is None and sensor.noise_ratio is None:
        return None
    axes = np.eye(3) if sensor.axes is None else sensor.axes
    count = len(axes)
    inner = np.linalg.inv(axes[:, :count])
    noise = inner if sensor.noise_ratio is None else inner * sensor.noise_ratio
    covariance = noise @ noise.T
    variance = float(np.trace(covariance)) / count
    inverse, shape = np.full((3, 3), np.nan), np.eye(3)
    inverse[:count, :count], shape[:count, :count] = inner, covariance / variance
    return SensorAxes(inverse, count, float(np.sqrt(variance)), shape)


@dataclass(frozen=True, eq=False)
class Levers:
    """The places at which the axes of a sensor read; `levers_of` makes them of a site file.

    The components are B = sum over places of ``part[g] @ B(place g)``, with parts that sum up to the identity.

    Attributes
    ----------
    lever_m : ndarray, shape (g, 3)
        From the sensor's reference point, in its frame.
    part : ndarray, shape (g, 3, 3)
    """

    lever_m: FloatArray
    part: FloatArray

    @property
    def reach_m(self) -> float:
        """Length of the longest lever."""
        return float(np.linalg.norm(self.lever_m, axis=1).max())


def levers_of(sensor: SensorSite) -> Levers | None:
    """Return the places at which a site's sensor reads; None if all its axes read at the reference point."""
    if sensor.lever_m is None:
        return None
    count = len(sensor.lever_m)
    axes = np.eye(3)
    if sensor.axes is not None:
        axes[:count] = sensor.axes
    lever = np.zeros((3, 3))
    lever[:count] = sensor.lever_m
    places, place_of = np.unique(lever, axis=0, return_inverse=True)
    part = np.zeros((len(places), 3, 3))
    np.add.at(part, place_of.ravel(), np.linalg.inv(axes).T[:, :, None] * axes[:, None, :])
    return Levers(places, part)

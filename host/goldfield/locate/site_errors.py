"""Errors of the site and of the sensor in the measured components: their covariance around a pose, and its whitening.

Beacon i is off by a shift, a turn about its centre and a part of its current, each with the deviations of its survey.
With B its field, G the gradient and q the point seen from the coil, these change the field by -G, by -[B]x + G [q]x and
by B; in the sensor's frame and with the noise a beacon's components then have the covariance

    C_i = sigma^2 I + R' (s_p^2 G G' + s_a^2 J J' + s_c^2 B B') R,      J = -[B]x + G [q]x.

The sensor measures (I + E) h in place of h. The antisymmetric part of E is a turn: no measurement tells it from one of
the sensor, so it goes into the attitude's covariance as it is. The symmetric part, three gains and three pairs of axes
that lean towards each other, correlates the components of all beacons: it adds S S' with S the effects of these six.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.rotations import skew
from goldfield.locate.sensor_axes import Levers, axes_of, levers_of
from goldfield.site import Beacon, SensorSite
from goldfield.site.model import EXACT
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class SiteErrors:
    """Standard deviations of what the site says of n beacons and of the sensor; see `Survey` and `SensorSite`.

    Attributes
    ----------
    position_sd_m, axis_sd_rad, current_sd : ndarray, shape (n,)
    gain_sd, sensor_axis_sd_rad : float
    noise_shape : ndarray, shape (3, 3), or None
        Covariance of the noise of a field's components over their variance (`SensorAxes`); None: the identity.
    levers : Levers or None
        Where the sensor's axes read, which is known: fits model it, a search takes it for an error.
    """

    position_sd_m: FloatArray
    axis_sd_rad: FloatArray
    current_sd: FloatArray
    gain_sd: float
    sensor_axis_sd_rad: float
    noise_shape: FloatArray | None = None
    levers: Levers | None = None

    @property
    def common_turn_rad2(self) -> float:
        """Variance of the turn about each axis by which all axes of the sensor lean alike."""
        return 0.5 * self.sensor_axis_sd_rad**2

    def subset(self, rows: NDArray[np.intp]) -> SiteErrors:
        """Return the errors of some of the beacons."""
        each = (self.position_sd_m[rows], self.axis_sd_rad[rows], self.current_sd[rows])
        return SiteErrors(*each, self.gain_sd, self.sensor_axis_sd_rad, self.noise_shape, self.levers)

    def isotropic(self, model: FieldModel, magnitude_T: FloatArray) -> FloatArray:
        """Return a standard deviation of each component by these errors, from magnitudes alone, T, shape (e, n).

        It is a mean over all directions from a dipole as far off as its field is weak: what a search starts with that
        knows no pose. The gradient's Frobenius norm is about 4 |B|/r, a turn's effect about 1.7 |B|.
        """
        moment = np.linalg.norm(model.moment_A_m2, axis=1)
        with np.errstate(divide="ignore"):
            range_m = np.maximum((1.5e-7 * moment / magnitude_T) ** (1.0 / 3.0), model.reach_m)
        moved_m = self.position_sd_m
        if self.levers is not None:
            moved_m = np.hypot(moved_m, self.levers.reach_m / np.sqrt(3.0))
        of_beacon = (4.0 * moved_m / range_m) ** 2 + 3.0 * self.axis_sd_rad**2 + self.current_sd**2
        of_sensor = self.gain_sd**2 + 2.0 * self.sensor_axis_sd_rad**2
        return np.asarray(magnitude_T * np.sqrt((of_beacon + of_sensor) / 3.0))


def errors_of(beacons: tuple[Beacon, ...], sensor: SensorSite) -> SiteErrors | None:
    """Return the errors that a site declares; None if all is exact and the sensor's axes are alike, at one point."""
    axes, levers = axes_of(sensor), levers_of(sensor)
    surveys = [beacon.survey for beacon in beacons]
    errors = SiteErrors(
        np.array([survey.position_sd_m for survey in surveys]),
        np.array([survey.axis_sd_rad for survey in surveys]),
        np.array([survey.current_sd for survey in surveys]),
        sensor.gain_sd,
        sensor.axis_sd_rad,
        None if axes is None else axes.noise_shape,
        levers,
    )
    exact = all(survey == EXACT for survey in surveys) and not (sensor.gain_sd or sensor.axis_sd_rad)
    return None if exact and axes is None and levers is None else errors


def effects_of_beacons(
    model: FieldModel, errors: SiteErrors, position_m: FloatArray, evaluated: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return what the beacons' errors, in standard deviations, do to their fields.

    Parameters
    ----------
    position_m : ndarray, shape (e, 3)
    evaluated : pair of ndarray
        Fields and gradients there, as `FieldModel.evaluate` returns them.

    Returns
    -------
    effect : ndarray, shape (e, n, 3, 7)
        Change of a field's component by place (3), turn (3) and current, in the site's frame, T.
    field_T : ndarray, shape (e, n, 3)
    """
    field, gradient = evaluated
    field, gradient = field.transpose(1, 2, 0), gradient.transpose(2, 3, 0, 1)
    turn = gradient @ skew(position_m[:, None] - model.centre_m) - skew(field)
    effect = np.empty((*field.shape, 7))
    effect[..., :3] = -errors.position_sd_m[:, None, None] * gradient
    effect[..., 3:6] = errors.axis_sd_rad[:, None, None] * turn
    effect[..., 6] = errors.current_sd[:, None] * field
    return effect, field


def effects_of_sensor(errors: SiteErrors, components_T: FloatArray) -> FloatArray:
    """Return what the sensor's errors, in standard deviations, do to components, shape (..., 3): shape (..., 3, 6)."""
    x, y, z = np.moveaxis(components_T, -1, 0)
    gain, lean = errors.gain_sd, errors.sensor_axis_sd_rad * np.sqrt(0.5)
    effect = np.zeros((*components_T.shape, 6))
    effect[..., 0, 0], effect[..., 1, 1], effect[..., 2, 2] = gain * x, gain * y, gain * z
    effect[..., 0, 3], effect[..., 1, 3] = lean * y, lean * x
    effect[..., 0, 4], effect[..., 2, 4] = lean * z, lean * x
    effect[..., 1, 5], effect[..., 2, 5] = lean * z, lean * y
    return effect

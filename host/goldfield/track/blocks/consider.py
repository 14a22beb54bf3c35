"""What the errors of the site and of the sensor do to the poses: a covariance beside the filter's (docs/blocks.md).

They are the same in every block, so that no average lessens them; the filter follows the bias that they make. Its gains
are those of a site without errors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.site_errors import SiteErrors, effects_of_beacons, effects_of_sensor, errors_of
from goldfield.site import Site
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.state import Motion
from goldfield.track.blocks.update import SEEN, reference
from goldfield.types import FloatArray

UNSEEN = 1e-9
"""Eigenvalues of the information, scaled to a diagonal of 1, below this are rounding: nothing follows along them."""


BENDS: FloatArray = np.array([np.maximum(pair, pair.T) for pair in np.eye(9)[[0, 4, 8, 1, 2, 5]].reshape(6, 3, 3)])
"""The symmetric matrices of one element each, which bend a vector without a turn: iron near the sensor bends all fields
alike. `goldfield.locate.fault_statistics.DISTORTIONS` spans the same, sorted by what a sensor's axes do."""


class Considered:
    """The errors that a site declares.

    Parameters
    ----------
    site : Site
    cycle : NormalForm
        A whole cycle: how much each beacon weighs. Its sums are not used.
    """

    def __init__(self, site: Site, cycle: NormalForm) -> None:
        self._model = FieldModel(site.beacons)
        self._errors: SiteErrors | None = errors_of(site.beacons, site.sensor)
        self._unknown_T = np.array([beacon.unknown_T for beacon in site.beacons])
        self._cycle = cycle
        self.any = self._errors is not None or bool(self._unknown_T.any())

    def covariance(self, motion: Motion, without: NDArray[np.intp]) -> FloatArray:
        """Return the covariance of position and attitude by these errors at a motion, shape (6, 6)."""
        bias = self._followed(motion, without, self._effects(motion))
        covariance = bias @ bias.T
        if self._errors is not None:
            covariance[3:, 3:] += self._errors.common_turn_rad2 * np.eye(3)
        return np.asarray(covariance)

    def bent(self, motion: Motion, without: NDArray[np.intp]) -> FloatArray:
        """Return the covariance of position and attitude if something bends all beacons' fields alike, shape (6, 6).

        The six numbers of a symmetric distortion have a standard deviation of one: the whole field.
        """
        fields = reference(self._model, motion).field_T.copy()
        fields[-1] = 0.0
        bias = self._followed(motion, without, (fields @ BENDS).transpose(1, 2, 0))
        return np.asarray(bias @ bias.T)

    def _followed(self, motion: Motion, without: NDArray[np.intp], effect: FloatArray) -> FloatArray:
        """Return how the pose follows errors of the fields, shape (n + 1, 3, k): the bias, shape (6, k)."""
        around = reference(self._model, motion)
        count = len(self._model)
        form = self._cycle.without(without)
        jacobian, weight = around.jacobian, around.weight(form)
        weighted = (weight @ jacobian).reshape(-1, SEEN)
        both = np.concatenate([jacobian, effect], axis=2)
        through = (form.gram @ both.reshape(count + 1, -1)).reshape(3 * (count + 1), -1)
        told = weighted.T @ through
        scale = np.sqrt(np.diag(told[:, :SEEN]))
        scale[scale == 0.0] = 1.0
        values, vectors = np.linalg.eigh(told[:, :SEEN] / np.outer(scale, scale))
        seen = values > UNSEEN
        part = vectors[:, seen] / scale[:, None]
        return np.asarray(((part / values[seen]) @ (part.T @ told[:, SEEN:]))[:6])

    def effects(self, motion: Motion) -> FloatArray | None:
        """Return what each error does to the fields as `_effects` does; None if the site declares none."""
        return self._effects(motion) if self.any else None

    def _effects(self, motion: Motion) -> FloatArray:
        """Return what each error, of one standard deviation, adds to the fields, site's frame, shape (n + 1, 3, k)."""
        count, sensor = len(self._model), None
        parts: list[FloatArray] = []
        field, gradient = self._model.evaluate(motion.position_m[:, None])
        if self._errors is not None:
            of_beacons, field_T = effects_of_beacons(
                self._model, self._errors, motion.position_m[None], (field, gradient)
            )
            parts.append(of_beacons[0])
            if self._errors.gain_sd or self._errors.sensor_axis_sd_rad:
                seen = np.vstack([field_T[0], motion.ambient_T]) @ motion.rotation
                sensor = motion.rotation @ effects_of_sensor(self._errors, seen)
        if self._unknown_T.any():
            parts.append(self._unknown_T[:, None, None] * np.eye(3))
        own = sum(part.shape[2] for part in parts)
        shared = 0 if sensor is None else sensor.shape[2]
        result = np.zeros((count + 1, 3, own * count + shared))
        each = np.concatenate(parts, axis=2)
        for beacon in range(count):
            result[beacon, :, own * beacon : own * (beacon + 1)] = each[beacon]
        if sensor is not None:
            result[:, :, own * count :] = sensor
        return result


class Allowance:
    """What is added to the covariance of a track's poses: the errors of the site, and metal that may bend the fields.

    It is computed once for several poses, in which it hardly changes.

    Parameters
    ----------
    considered : Considered

    Attributes
    ----------
    covariance : ndarray, shape (6, 6), or None
        What was added last.
    """

    def __init__(self, considered: Considered) -> None:
        self._considered = considered
        self.forget()

    def forget(self) -> None:
        """Compute all anew for the next pose."""
        self._site: FloatArray | None = None
        self._bent: FloatArray | None = None
        self.covariance: FloatArray | None = None

    def of_site(self, motion: Motion, out: NDArray[np.intp]) -> FloatArray | None:
        """Return the covariance by the errors of the site alone, shape (6, 6); None if it declares none."""
        if self._site is None and self._considered.any:
            self._site = self._considered.covariance(motion, out)
        return self._site

    def added_to(self, known: Estimate, out: NDArray[np.intp], share: float, anew: bool) -> Estimate:
        """Add to what is known of a moment; ``share`` is that of the fields which may be bent, `Evenness.share`."""
        if anew:
            self._site = self._bent = None
        self.covariance = self.of_site(known.motion, out)
        if share:
            if self._bent is None:
                self._bent = self._considered.bent(known.motion, out)
            bent = share**2 * self._bent
            self.covariance = bent if self.covariance is None else self.covariance + bent
        if self.covariance is None:
            return known
        covariance = known.covariance.copy()
        covariance[:6, :6] += self.covariance
        return Estimate(known.motion, covariance)

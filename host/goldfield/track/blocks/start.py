"""Where a track begins: the locator's pose of one block, or of a few where one does not tell (docs/blocks.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from goldfield.locate import Locator
from goldfield.locate.rotations import matrix_of
from goldfield.site import Site
from goldfield.track.blocks.bank import START_RATE_RAD_S, START_VELOCITY_M_S, WIDENED, Start
from goldfield.track.blocks.equations import BlockEquations, NormalForm, separated
from goldfield.types import Fields, FloatArray, Pose, Status

AMBIENT_T = 5e-6
"""Deviation of the ambient field of a start beside its noise."""

FARTHEST_M = 1e4
"""Deviation of a position from which on it is none to begin with; that of one which the fields do not tell is 1 km.
Neither is one that is so far from every coil along an axis: codes that are interchanged put it at 1e70 m."""

PATIENCE = 5
"""So many single blocks in a row that do not agree with the site are enough: the track begins, and says so."""


class Starter:
    """Finds the starts of a site's tracks from the blocks that come.

    Parameters
    ----------
    site : Site
    equations : BlockEquations
    """

    def __init__(self, site: Site, equations: BlockEquations) -> None:
        self._site, self._equations = site, equations
        self._locator = Locator(site)
        self._ids = tuple(beacon.id for beacon in site.beacons)
        self._moment_A_m2 = np.linalg.norm(self._locator.model.moment_A_m2, axis=1)
        self._reach_m = self._locator.model.reach_m
        self._kept: list[NormalForm] = []
        self._taken = self._contradictions = 0
        self._last_s = -math.inf

    def forget(self) -> None:
        """Begin anew: earlier blocks are of another time."""
        self._kept, self._taken, self._contradictions = [], 0, 0

    def located(
        self, form: NormalForm, epoch: int, time_s: float, without: Sequence[str] = ()
    ) -> tuple[Pose, list[Start]]:
        """Locate by one more block; where no single one tells the pose, by twice as many each time, up to a cycle.

        Returns
        -------
        pose : Pose
            What the locator says of the block.
        starts : list of Start
            None where there is no pose to begin with, two if the pose is ambiguous.
        """
        period_s = 2.0 * form.end_s + self._site.chip_period_s
        if time_s - self._last_s > 1.5 * period_s:  # those before are of another time
            self.forget()
        self._last_s = time_s
        self._kept.append(form)
        self._taken += 1
        most = max(round(self._site.cycle_s / period_s), 1)
        del self._kept[:-most]
        pose, starts = self._of(self._kept[-1:], epoch, time_s, without, most)
        count = 2
        while not starts and self._worth_more(pose) and count <= len(self._kept) and self._taken % count == 0:
            pose, starts = self._of(self._kept[-count:], epoch, time_s, without, most)
            count = min(2 * count, most) if count < most else most + 1
        return pose, starts

    @staticmethod
    def _worth_more(pose: Pose) -> bool:
        """Tell whether more blocks can help: those of a moving sensor that contradict the site do so the more."""
        return pose.status in (Status.FAILED, Status.WEAK)

    def _of(
        self, forms: Sequence[NormalForm], epoch: int, time_s: float, without: Sequence[str], most: int
    ) -> tuple[Pose, list[Start]]:
        """Locate by some blocks."""
        form, found = forms[-1], separated(forms)
        ambient = self._ambient(form, found.field_T)
        swept_T = np.linalg.norm(found.sweep_s * self._slopes(found.field_T, ambient), axis=1)
        sigma = np.hypot(self._site.sensor.noise_T * found.deviation, swept_T)
        rows = [
            row for row, name in enumerate(self._ids) if name not in without and math.isfinite(found.deviation[row])
        ]
        fields = Fields(
            epoch,
            time_s,
            tuple(self._ids[row] for row in rows),
            self._equations.readings(found.field_T[rows], form.axes),
            sigma[rows],
        )
        pose = self._locator.locate(fields)
        if pose.status is Status.FAILED or (pose.status is Status.WEAK and len(forms) < most):
            return pose, []
        if pose.status is Status.INCONSISTENT:
            self._contradictions += 1
            if self._contradictions < PATIENCE and len(forms) < most:
                return pose, []
        both = [pose, pose.alternative] if pose.status is Status.AMBIGUOUS else [pose]
        begun = [one for one in both if one is not None and self._somewhere(one)]
        out = np.array([row for row, name in enumerate(self._ids) if name in (*without, *pose.excluded)], dtype=np.intp)
        kept = tuple(one.without(out) for one in forms) if begun else ()
        return pose, [self._start(one, ambient, kept) for one in begun]

    def _somewhere(self, pose: Pose) -> bool:
        """Tell whether a pose is one to begin with: beside a wire its covariance may be beyond all bounds."""
        near = np.abs(pose.position_m - self._locator.model.centre_m).max(axis=1).min() < FARTHEST_M
        known = np.trace(pose.position_cov_m2) < FARTHEST_M**2 and np.isfinite(pose.attitude_cov_rad2).all()
        return bool(near and known)

    def _slopes(self, field_T: FloatArray, ambient_T: FloatArray) -> FloatArray:
        """Return how fast the fields of a sensor in motion may change, shape (n + 1,), T/s: a dipole by 3 B/r."""
        size = np.linalg.norm(np.nan_to_num(np.vstack([field_T, ambient_T])), axis=1)
        by_motion = START_RATE_RAD_S * size
        range_m = np.cbrt(1.5e-7 * self._moment_A_m2 / np.maximum(size[:-1], 1e-12))
        by_motion[:-1] += 3.0 * START_VELOCITY_M_S * size[:-1] / np.maximum(range_m, self._reach_m)
        return np.asarray(by_motion)

    @staticmethod
    def _ambient(form: NormalForm, field_T: FloatArray) -> FloatArray:
        """Return the ambient field of a block in the sensor's frame, shape (3,)."""
        count = len(field_T)
        of_beacons = form.gram[count, :count] @ np.nan_to_num(field_T)
        return np.asarray((form.sums_T[count] - of_beacons) / form.gram[count, count])

    def _start(self, pose: Pose, ambient: FloatArray, blocks: tuple[NormalForm, ...]) -> Start:
        """Return the start at the last of some blocks, over which the sensor may have moved."""
        rotation, form = matrix_of(pose.orientation_xyzw), blocks[-1]
        spacing_s = 2.0 * form.end_s + self._site.chip_period_s
        behind_s = 0.5 * (len(blocks) - 1) * spacing_s
        covariance = np.diag(np.repeat([(START_VELOCITY_M_S * behind_s) ** 2, (START_RATE_RAD_S * behind_s) ** 2], 3))
        covariance[:3, :3] += WIDENED**2 * pose.position_cov_m2
        covariance[3:, 3:] += WIDENED**2 * pose.attitude_cov_rad2
        noise = self._site.sensor.noise_T**2 / form.gram[-1, -1]
        ambient_cov = (AMBIENT_T**2 + noise) * np.eye(3)
        return Start(pose.position_m, rotation, covariance, rotation @ ambient, ambient_cov, blocks, spacing_s)

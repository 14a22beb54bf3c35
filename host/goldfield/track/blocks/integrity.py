"""Whether the sensor's blocks agree with the site: once a cycle, by the tests of `goldfield.locate` and the witness.

What a motion leaves of the blocks of a cycle is separated like samples of a sensor at rest: the error of each beacon's
field along the path. Added to the fields that the site lets expect at the middle of the cycle, these are the fields
that a sensor at rest there would have had: a `Fields` like any other, which `Locator` and `Witness` judge with no
knowledge of the track. So a fault that draws the track with it does not hide behind it. The field of a beacon that is
left out is unknown in each block: what it does beside that of the site would leak into the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.locate import Locator
from goldfield.locate.locator import LEAST_BEACONS
from goldfield.site import Site
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.equations import BlockEquations, NormalForm, separated
from goldfield.track.blocks.state import Motion
from goldfield.track.blocks.update import MOTION, MOVING, Reference, reference
from goldfield.track.continuity import joined
from goldfield.track.estimate import Belief
from goldfield.track.faults import Judgement, judged
from goldfield.track.motion import State
from goldfield.track.observe import EpochObserver
from goldfield.track.witness import Witness
from goldfield.types import Fields, Finding, FloatArray, Pose, Status

KNOWN = np.repeat([1.0, 1.0, 1e-3, 1e-3, 1e-9], 3)
"""Standard deviations of what is believed before a cycle is judged: its motion has been taken out, its pose is free."""


QUICK = 4
"""With every so manieth block it is asked whether the fields are so far off that the cycle need not be waited for."""

FAR_OFF = 8.0
"""They are if their chi-square is so many standard deviations of chance above its mean, and above `TRACKED`."""

TRACKED = 30.0
"""What the error of the track may add to chi-square."""

USUAL = 3.0
"""And above so many times what the errors of the site have left in the last cycle."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a cycle's blocks say of the site.

    Attributes
    ----------
    pose : Pose
        What the locator says of the fields by themselves, with no knowledge of the track.
    motion : Motion
        The track's motion at the time of this pose, as it was before the verdict.
    excluded : tuple of str
        Beacons that are not as the site says.
    inconsistent : bool
        The fields do not agree with the site, and leaving out such a beacon does not mend it.
    silent : bool
        Nothing but noise was heard.
    judgement : Judgement or None
        What the fields say of the beacons that are not left out; None for a block that a track has begun with.
    """

    pose: Pose
    motion: Motion | None = None
    excluded: tuple[str, ...] = ()
    inconsistent: bool = False
    silent: bool = False
    judgement: Judgement | None = None

    def protection_m(self, position_cov_m2: FloatArray) -> float:
        """Return the radius that the error of a position of this covariance exceeds undetected only rarely."""
        if self.judgement is not None:
            return self.judgement.protection_m(position_cov_m2)
        wider = float(np.trace(position_cov_m2) / np.trace(self.pose.position_cov_m2))
        return self.pose.protection_m * math.sqrt(max(wider, 1.0))


class Integrity:
    """Judges what a track leaves of its blocks.

    Parameters
    ----------
    site : Site
    equations : BlockEquations

    Attributes
    ----------
    witness : Witness
        Watches the beacons over many cycles.
    """

    def __init__(self, site: Site, equations: BlockEquations) -> None:
        self.witness = Witness(site)
        self._site, self._equations = site, equations
        self._locator = Locator(site)
        self._observer = EpochObserver(site)
        self._ids = tuple(beacon.id for beacon in site.beacons)
        self._row = {name: row for row, name in enumerate(self._ids)}
        self._usual = 0.0
        self._blamed: dict[str, Finding] = {}
        self.forget()

    def forget(self) -> None:
        """Begin a cycle anew."""
        self._rests: list[NormalForm] = []
        self._references: list[tuple[Reference, float]] = []
        self._blurs: list[FloatArray] = []
        self._seconds = 0.0

    def add(
        self, form: NormalForm, known: Estimate, epoch: int, middle_s: float, without: Sequence[str]
    ) -> Verdict | None:
        """Add a block and what is known of its middle; return a verdict once a cycle, or when it cannot wait.

        A block that the track has refused is not to be added: it says nothing of the beacons. ``without`` are the
        beacons that the track leaves out.
        """
        around = reference(self._locator.model, known.motion)
        rest = around.residual(form) @ known.motion.rotation  # in the sensor's frame
        self._blurs.append(self._blur(form, around, known.covariance))
        self._rests.append(replace(form, sums_T=rest))
        self._references.append((around, middle_s))
        self._seconds += 2.0 * form.end_s + self._site.chip_period_s
        rows = np.array([self._row[name] for name in without if name in self._row], dtype=np.intp)
        whole = self._seconds >= (1.0 - 0.5 / len(self._rests)) * self._site.cycle_s
        if not whole and (len(self._rests) % QUICK or not self._far_off(rows)):
            return None
        verdict = self._judged(epoch, without, rows)
        self.forget()
        return verdict

    def _blur(self, form: NormalForm, around: Reference, covariance: FloatArray) -> FloatArray:
        """Return what the track's error adds to the variance of a block's sums, over a sample's, shape (n,).

        An error that stays is a pose, which is free anyway; one that changes from block to block leaks from field to
        field, since the codes are not orthogonal within a block.
        """
        pose = around.jacobian[..., :MOVING]
        still, moving = (
            ((pose @ covariance[part, part]) * pose).sum(axis=(1, 2)) / 3.0 for part in (slice(0, MOVING), MOTION)
        )
        leaks = form.beside_ambient(form.gram)
        leaks.flat[:: leaks.shape[1] + 1] = 0.0
        slopes = form.beside_ambient(form.moment)
        leaked = (leaks * leaks) @ still + (slopes * slopes) @ moving
        return np.asarray(leaked / self._site.sensor.noise_T**2)

    def _far_off(self, out: NDArray[np.intp]) -> bool:
        """Tell whether the fields of the last few blocks are far from what the site lets expect."""
        cost, freedom = self._cost([rest.without(out) for rest in self._rests[-QUICK:]], self._blurs[-QUICK:])
        limit = freedom + FAR_OFF * math.sqrt(2.0 * freedom) + TRACKED
        return cost > limit + USUAL * self._usual * QUICK

    @staticmethod
    def _cost(rests: Sequence[NormalForm], blurs: Sequence[FloatArray]) -> tuple[float, int]:
        """Return chi-square of what is left of the fields, and about its mean."""
        found, weight = separated(rests, np.sum(blurs, axis=0)), rests[-1].weight
        heard = np.isfinite(found.deviation)
        field = found.field_T[heard] / found.deviation[heard, None]
        return float(((field @ weight) * field).sum()), 3 * int(heard.sum())

    def _judged(self, epoch: int, without: Sequence[str], out: NDArray[np.intp]) -> Verdict | None:
        """Judge the blocks that there are: first all beacons, then, if they do not agree, those in the track alone."""
        kept = [rest.without(out) for rest in self._rests]
        cost, freedom = self._cost(kept, self._blurs)
        self._usual = max(cost - freedom, 0.0) / len(kept)
        around, _ = self._references[len(self._references) // 2]
        fields = self._fields(self._rests, epoch)
        if len(fields.beacons) < LEAST_BEACONS:  # the blocks do not tell them apart
            return None
        pose = self._locator.locate(fields)
        judgement = self._judgement(fields, around.motion, ())
        self.witness.update(judgement)
        sound = pose.status not in (Status.FAILED, Status.INCONSISTENT) and not pose.excluded
        self._blamed = (
            {} if sound else self._blamed | {name: found for found in pose.findings for name in found.beacons}
        )
        if len(out) and not sound:
            fields = self._fields(kept, epoch)
            pose = self._explained(self._locator.locate(fields), without)
        if pose.status is Status.FAILED:
            return Verdict(pose, around.motion, tuple(without), silent=True)
        verdict = self._witnessed(Verdict(pose, around.motion, pose.excluded, pose.status is Status.INCONSISTENT))
        if verdict.excluded:
            judgement = self._judgement(fields, around.motion, verdict.excluded)
        return replace(verdict, judgement=judgement)

    def _explained(self, pose: Pose, without: Sequence[str]) -> Pose:
        """Return a pose made without some beacons, with what was last found of these."""
        known = list(dict.fromkeys(self._blamed[name] for name in without if name in self._blamed))
        reason = pose.reason
        for found in reversed(known):
            reason = joined(f"left out: {found.text}", reason)
        excluded = (*without, *(name for name in pose.excluded if name not in without))
        return replace(pose, excluded=excluded, findings=(*known, *pose.findings), reason=reason)

    def _fields(self, rests: Sequence[NormalForm], epoch: int) -> Fields:
        """Return the fields that a sensor at rest at the middle of the blocks would have had."""
        found = separated(rests, np.sum(self._blurs, axis=0))
        around, time_s = self._references[len(self._references) // 2]
        rows = np.flatnonzero(np.isfinite(found.deviation))
        components = (around.field_T[:-1] @ around.motion.rotation + found.field_T)[rows]
        axes = np.logical_and.reduce([rest.axes for rest in rests])
        return Fields(
            epoch,
            time_s,
            tuple(self._ids[row] for row in rows),
            self._equations.readings(components, axes),
            self._site.sensor.noise_T * found.deviation[rows],
            sweep_T_s=0.0,
        )

    def _witnessed(self, verdict: Verdict) -> Verdict:
        """Add what the witness knows of many cycles."""
        finding = self.witness.finding
        if finding is None:
            return verdict
        pose = verdict.pose
        named = tuple(name for name in finding.beacons if name not in verdict.excluded)
        if named:
            pose = replace(pose, findings=(*pose.findings, finding), reason=joined(pose.reason, finding.text))
        return replace(verdict, pose=pose, excluded=(*verdict.excluded, *named))

    def _judgement(self, fields: Fields, motion: Motion, without: Sequence[str]) -> Judgement | None:
        """Return what the fields say of each beacon by the linear tests of a track, its motion taken out."""
        state = State(motion.position_m, motion.rotation, np.zeros(3), np.zeros(3), np.zeros(3))
        observation, heard = self._observer.observation(fields, 0.0, without)
        return judged(observation, state, Belief(state, np.diag(KNOWN))) if heard else None

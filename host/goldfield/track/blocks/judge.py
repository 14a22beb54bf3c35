"""What the blocks of a cycle say of the site, as `goldfield.locate` and the witness judge it.

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
from goldfield.track.blocks.equations import BlockEquations, NormalForm, separated
from goldfield.track.blocks.rest import cost_of
from goldfield.track.blocks.state import Motion
from goldfield.track.blocks.update import Reference
from goldfield.track.continuity import joined
from goldfield.track.estimate import Belief
from goldfield.track.faults import Judgement, judged
from goldfield.track.motion import State
from goldfield.track.observe import EpochObserver
from goldfield.track.witness import Witness
from goldfield.types import Fields, Finding, FloatArray, Pose, Status

KNOWN = np.repeat([1.0, 1.0, 1e-3, 1e-3, 1e-9], 3)
"""Standard deviations of what is believed before a cycle is judged: its motion has been taken out, its pose is free."""


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


@dataclass(frozen=True, eq=False)
class Cycle:
    """What a track has left of some successive blocks.

    Attributes
    ----------
    epoch : int
    rests : tuple of NormalForm
        The blocks, with the sums that the motion leaves of them, in the sensor's frame.
    blurs : tuple of ndarray, shape (n,)
        What the track's error adds to the variance of each block's sums, over a sample's.
    middle : Reference
        The fields at the block in the middle.
    middle_s : float
    without : tuple of str
        Beacons that the track leaves out.
    out : ndarray of int
        Their rows.
    """

    epoch: int
    rests: tuple[NormalForm, ...]
    blurs: tuple[FloatArray, ...]
    middle: Reference
    middle_s: float
    without: tuple[str, ...]
    out: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Judged:
    """What became of a cycle.

    Attributes
    ----------
    excess : float
        By how much chi-square of its fields is above the mean of chance, over the number of its blocks.
    verdict : Verdict or None
        None if the blocks do not tell the beacons apart.
    """

    excess: float
    verdict: Verdict | None


class Judge:
    """Judges the cycles of one sensor, one after the other; nobody else touches what it knows.

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
        self._blamed: dict[str, Finding] = {}

    def judged(self, cycle: Cycle) -> Judged:
        """Judge a cycle: first all beacons, then, if they do not agree, those in the track alone."""
        kept = tuple(rest.without(cycle.out) for rest in cycle.rests)
        cost, freedom = cost_of(kept, cycle.blurs)
        return Judged(max(cost - freedom, 0.0) / len(kept), self._verdict(cycle, replace(cycle, rests=kept)))

    def _verdict(self, cycle: Cycle, kept: Cycle) -> Verdict | None:
        fields, motion = self._fields(cycle), cycle.middle.motion
        if len(fields.beacons) < LEAST_BEACONS:  # the blocks do not tell them apart
            return None
        pose = self._locator.locate(fields)
        judgement = self._judgement(fields, motion, ())
        self.witness.update(judgement)
        sound = pose.status not in (Status.FAILED, Status.INCONSISTENT) and not pose.excluded
        self._blamed = (
            {} if sound else self._blamed | {name: found for found in pose.findings for name in found.beacons}
        )
        if len(cycle.out) and not sound:
            fields = self._fields(kept)
            pose = self._explained(self._locator.locate(fields), cycle.without)
        if pose.status is Status.FAILED:
            return Verdict(pose, motion, cycle.without, silent=True)
        verdict = self._witnessed(Verdict(pose, motion, pose.excluded, pose.status is Status.INCONSISTENT))
        if verdict.excluded:
            judgement = self._judgement(fields, motion, verdict.excluded)
        return replace(verdict, judgement=judgement)

    def _explained(self, pose: Pose, without: Sequence[str]) -> Pose:
        """Return a pose made without some beacons, with what was last found of these."""
        known = list(dict.fromkeys(self._blamed[name] for name in without if name in self._blamed))
        reason = pose.reason
        for found in reversed(known):
            reason = joined(f"left out: {found.text}", reason)
        excluded = (*without, *(name for name in pose.excluded if name not in without))
        return replace(pose, excluded=excluded, findings=(*known, *pose.findings), reason=reason)

    def _fields(self, cycle: Cycle) -> Fields:
        """Return the fields that a sensor at rest at the middle of the blocks would have had."""
        found = separated(cycle.rests, np.sum(cycle.blurs, axis=0))
        rows = np.flatnonzero(np.isfinite(found.deviation))
        components = (cycle.middle.field_T[:-1] @ cycle.middle.motion.rotation + found.field_T)[rows]
        axes = np.logical_and.reduce([rest.axes for rest in cycle.rests])
        return Fields(
            cycle.epoch,
            cycle.middle_s,
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

"""Whether the sensor's blocks agree with the site: once a cycle, by the tests of `goldfield.locate` and the witness.

What a motion leaves of the blocks of a cycle is separated like samples of a sensor at rest: the error of each beacon's
field along the path. Added to the fields that the site lets expect at the middle of the cycle, these are the fields
that a sensor at rest there would have had: a `Fields` like any other, which `Locator` and `Witness` judge with no
knowledge of the track. So a fault that draws the track with it does not hide behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from goldfield.locate import Locator
from goldfield.site import Site
from goldfield.track.blocks.equations import BlockEquations, NormalForm, separated
from goldfield.track.blocks.state import Motion
from goldfield.track.blocks.update import Reference, reference
from goldfield.track.estimate import Belief
from goldfield.track.faults import judged
from goldfield.track.motion import State
from goldfield.track.observe import EpochObserver
from goldfield.track.witness import Witness
from goldfield.types import Fields, Pose, Status

KNOWN = np.repeat([1.0, 1.0, 1e-3, 1e-3, 1e-9], 3)
"""Standard deviations of what is believed before a cycle is judged: its motion has been taken out, its pose is free."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a cycle's blocks say of the site.

    Attributes
    ----------
    pose : Pose
        What the locator says of the fields by themselves, with no knowledge of the track.
    excluded : tuple of str
        Beacons that are not as the site says.
    inconsistent : bool
        The fields do not agree with the site, and leaving out such a beacon does not mend it.
    silent : bool
        Nothing but noise was heard.
    """

    pose: Pose
    excluded: tuple[str, ...] = ()
    inconsistent: bool = False
    silent: bool = False


class Integrity:
    """Judges what a track leaves of its blocks.

    Parameters
    ----------
    site : Site
    equations : BlockEquations
    model : FieldModel
        All beacons of the site.
    """

    def __init__(self, site: Site, equations: BlockEquations) -> None:
        self._site, self._equations = site, equations
        self._locator = Locator(site)
        self._model = self._locator.model
        self._observer = EpochObserver(site)
        self.witness = Witness(site)
        self._ids = tuple(beacon.id for beacon in site.beacons)
        self.forget()

    def forget(self) -> None:
        """Begin a cycle anew."""
        self._rests: list[NormalForm] = []
        self._references: list[tuple[Reference, float]] = []
        self._seconds = 0.0

    def add(self, form: NormalForm, motion: Motion, epoch: int, middle_s: float) -> Verdict | None:
        """Add a block and the motion at its middle; return the verdict when a cycle is complete.

        A block that the track has refused is not to be added: it says nothing of the beacons.
        """
        around = reference(self._model, motion)
        rest = around.residual(form) @ motion.rotation  # in the sensor's frame
        self._rests.append(replace(form, sums_T=rest))
        self._references.append((around, middle_s))
        self._seconds += 2.0 * form.end_s + self._site.chip_period_s
        if self._seconds < (1.0 - 0.5 / len(self._rests)) * self._site.cycle_s:
            return None
        verdict = self._judged(epoch)
        self.forget()
        return verdict

    def _judged(self, epoch: int) -> Verdict:
        found = separated(self._rests)
        around, time_s = self._references[len(self._references) // 2]
        motion = around.motion
        rows = np.flatnonzero(np.isfinite(found.deviation))
        components = (around.field_T[:-1] @ motion.rotation + found.field_T)[rows]
        names = tuple(self._ids[row] for row in rows)
        axes = np.logical_and.reduce([rest.axes for rest in self._rests])
        fields = Fields(
            epoch,
            time_s,
            names,
            self._equations.readings(components, axes),
            self._site.sensor.noise_T * found.deviation[rows],
            sweep_T_s=0.0,
        )
        pose = self._locator.locate(fields)
        self._learn(fields, motion)
        if pose.status is Status.FAILED:
            return Verdict(pose, silent=True)
        named = tuple(name for name in self.witness.named if name not in pose.excluded)
        if named:
            told = self.witness.finding
            pose = replace(pose, findings=(*pose.findings, *(() if told is None else (told,))))
        return Verdict(pose, (*pose.excluded, *named), pose.status is Status.INCONSISTENT)

    def _learn(self, fields: Fields, motion: Motion) -> None:
        """Show the cycle to the witness."""
        state = State(motion.position_m, motion.rotation, np.zeros(3), np.zeros(3), np.zeros(3))
        observation, heard = self._observer.observation(fields, 0.0)
        prior = Belief(state, np.diag(KNOWN))
        self.witness.update(judged(observation, state, prior) if heard else None)

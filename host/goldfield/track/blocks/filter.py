"""The track of one sensor from blocks of chips: a pose with each, at the end of the block (docs/blocks.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.locate.rotations import matrix_of
from goldfield.site import Site
from goldfield.track.blocks.backward import Step
from goldfield.track.blocks.bank import WIDENED, Bank, Estimate, Start
from goldfield.track.blocks.consider import Allowance, Considered
from goldfield.track.blocks.equations import BlockEquations, NormalForm
from goldfield.track.blocks.evenness import EVEN_T, Evenness
from goldfield.track.blocks.integrity import Integrity
from goldfield.track.blocks.judge import Verdict
from goldfield.track.blocks.kernel import CBank, serves
from goldfield.track.blocks.pair import Pair
from goldfield.track.blocks.start import AMBIENT_T, Starter
from goldfield.track.blocks.state import AMBIENT, POSITION, TURN
from goldfield.track.continuity import Hemisphere, joined, time_break
from goldfield.track.report import Reporter
from goldfield.types import Block, Fields, FloatArray, Pose, Status

PATIENCE = 10
"""A track is begun anew at so many blocks in a row that contradict it, 30 ms; at the first after a gap."""

DOUBTED = 3
"""From so many on the pose is ``inconsistent``: one or two are an impulse."""

GAP_S = 0.05
"""A time without a block, from which on the next one that contradicts the track begins a new one at once."""

VAGUE = 0.1
"""After a gap a block is located by itself if the deviation of the position is this part of the distance to the nearest
coil, or that of the attitude so many radians: the fields are not linear over such errors."""

DRAWN_M_S, DRAWN_RAD_S = 0.5, 0.5
"""By how much the velocity and the turn rate of a track may be wrong that a beacon has drawn with it."""

ASTRAY = 60.0
"""A track is elsewhere than the locator has the sensor if the squared distance over its covariance is larger: 1e-12."""

RIVAL = 15.0
"""A rival start is given up when its -2 log likelihood is this much higher: 1800 to one are the odds."""

CONSIDERED = 8
"""What the errors of the site do is computed with every so manieth block: 25 ms, in which it hardly changes."""

NEAR_S = 60.0
"""Longest time from the last block for which there is a pose: its deviation is 2 km then at the greatest agility."""

UNHEARD_S = 1.0
"""The track is given up after this time in which no beacon was heard."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """What a `BlockFilter` knows of the sensor at one moment.

    Attributes
    ----------
    time_s : float
    position_m : ndarray, shape (3,)
    rotation : ndarray, shape (3, 3)
        ``B_site = R B_sensor``.
    velocity_m_s, rate_rad_s : ndarray, shape (3,)
        In the site's frame.
    ambient_T : ndarray, shape (3,)
        In the site's frame.
    offset_T : ndarray, shape (3,)
        The sensor's offset, in its own frame.
    covariance : ndarray, shape (18, 18)
        Covariance of the errors of all these, in this order; the attitude's is a small rotation in the site's frame.
    """

    time_s: float
    position_m: FloatArray
    rotation: FloatArray
    velocity_m_s: FloatArray
    rate_rad_s: FloatArray
    ambient_T: FloatArray
    offset_T: FloatArray
    covariance: FloatArray


class BlockFilter:
    """Tracks one sensor: give it every block in the order of time, it returns the pose at each block's end.

    Parameters
    ----------
    site : Site
    kernel : bool
        Take the C version where it serves: circular coils, no metal, axes of equal noise.
    aside : Executor, optional
        Where cycles are judged: a thread for it keeps the blocks from waiting. The poses are the same.
    even_T : float
        By how much the ambient field may differ from place to place. A larger change is taken for iron that may bend
        the beacons' fields: the covariance allows for it.

    Raises
    ------
    UserError
        If the site is of a kind that no block filter can follow: tones of unknown phase, or a sensor with levers.
    """

    def __init__(
        self, site: Site, *, kernel: bool = True, aside: Executor | None = None, even_T: float = EVEN_T
    ) -> None:
        self._site = site
        self._equations = BlockEquations(site)
        self._model = FieldModel(site.beacons)
        self._considered = Considered(site, self._equations.cycle)
        self._allowance = Allowance(self._considered)
        self._starter = Starter(site, self._equations)
        self._integrity = Integrity(site, self._equations, self._considered, aside)
        self._reporter, self._hemisphere = Reporter(site), Hemisphere()
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        equal = site.sensor.axes is None and site.sensor.noise_ratio is None
        self._in_c = kernel and equal and serves(self._model)
        self._precise = False  # single precision did not do for the last track
        self._banks: list[Pair] = []
        self._verdict: Verdict | None = None
        self._excluded: tuple[str, ...] = ()
        self._without: tuple[str, ...] = ()
        self._middle_s = self._taken_s = self._heard_s = self._end_s = -math.inf
        self._blocks = self._track = 0
        self._evenness, self._judged_s = Evenness(even_T, site.ambient_gradient_T_m), 0.0
        self._level: tuple[Verdict, float, float] | None = None
        self._axes = 3
        self._epoch = -1
        self._untracked: str | None = None  # why the last block, if there is no track, began none

    def update(
        self, block: Block, without: Sequence[str] = (), ratio: Mapping[str, float] | None = None
    ) -> Pose | None:
        """Take a block and return the pose at its end, the time of its last sample; None if it holds no data.

        The pose's ``epoch`` is the cycle of the block's last chip. ``without`` lists beacons that are left out, and
        ``ratio`` has the current of the block over the site's of the beacons where they differ.

        - ``ok``: the last cycle's blocks agree with the track and the site; ``excluded`` lists beacons left out.
        - ``unverified``: they agree, but a fault of one beacon could hide an error above the site's alert limit.
        - ``ambiguous``: the track began with two poses, and the blocks do not yet tell which; ``alternative``.
        - ``weak``: the standard deviation is as large as `locate` calls weak, or no beacon was heard for a while.
        - ``inconsistent``: the last blocks contradict the track, and the pose is predicted, or the last cycle's
          contradict the site.
        - ``failed``: there is no track, and the block does not begin one.
        """
        form = self._equations.form(block)
        if form is None or not math.isfinite(block.time_s):
            return None
        if ratio:
            form = form.scaled(np.array([ratio.get(name, 1.0) for name in self._row]))
        broken = time_break(self._end_s, block.time_s)
        if broken is not None:
            self._forget()
            broken += ": a new track begins"
        self._epoch = block.cycle + (block.chip + block.chips - 1) // self._site.chips
        self._axes, self._without = int(form.axes.sum()), tuple(without)
        middle_s, self._end_s = block.time_s - form.end_s, block.time_s
        located = self._go_on(form, middle_s) if self._banks else self._begin(form, middle_s)
        pose = self._located(located) if not self._banks else self._pose(self._end_s)
        self._untracked = pose.reason
        if broken is not None:
            pose = replace(pose, reason=joined(pose.reason, broken))
        return self._hemisphere.follow(pose)

    def pose_at(self, time_s: float) -> Pose:
        """Return the pose at any time near the last block's, with the uncertainty that the motion adds.

        Raises
        ------
        UserError
            If the time is none, or further than `NEAR_S` from that of the last block.
        """
        if math.isfinite(self._end_s) and not abs(time_s - self._end_s) <= NEAR_S:
            raise UserError(
                f"time_s= of pose_at is {time_s:g} s and the last block ended at {self._end_s:.3f} s: ask for a time "
                f"within {NEAR_S:g} s of it"
            )
        if not self._banks:
            nothing = Fields(self._epoch, time_s, (), np.empty((0, 3)), np.empty(0))
            reason = "there is no track"
            return Pose.failed(nothing, reason=joined(reason, self._untracked) or reason)
        return self._hemisphere.nearest(self._pose(time_s))

    @property
    def state(self) -> Tracked | None:
        """What is known at the end of the last block; None without a track."""
        if not self._banks:
            return None
        known = self._known(self._banks[0], self._end_s)
        motion = known.motion
        return Tracked(
            self._end_s,
            motion.position_m,
            motion.rotation,
            motion.velocity_m_s,
            motion.rate_rad_s,
            motion.ambient_T,
            motion.offset_T,
            known.covariance,
        )

    @property
    def step(self) -> Step | None:
        """What was believed at the middle of the last block; None without a track."""
        if not self._banks:
            return None
        bank = self._banks[0]
        return Step(self._track, self._middle_s, bank.output(), bank.agility, self._allowance.covariance)

    def _forget(self) -> None:
        """Give the track up."""
        self._banks, self._verdict = [], None
        self._precise = False
        self._evenness.forget()
        self._excluded = ()
        self._starter.forget()
        self._integrity.forget()
        self._integrity.watch.alarm, self._integrity.watch.share = False, 0.0

    @property
    def _out(self) -> tuple[str, ...]:
        """Beacons that are left out."""
        return (*self._without, *(name for name in self._excluded if name not in self._without))

    def _rows(self, names: Sequence[str]) -> NDArray[np.intp]:
        return np.array([self._row[name] for name in names if name in self._row], dtype=np.intp)

    def _go_on(self, form: NormalForm, middle_s: float) -> Pose | None:
        """Follow the track to a block's middle and take the block."""
        kept = form.without(self._rows(self._out))
        seconds, gap_s = middle_s - self._middle_s, middle_s - self._taken_s
        if gap_s > GAP_S:
            for bank in self._banks:
                bank.predict(seconds)
            self._middle_s, seconds = middle_s, 0.0
            if self._too_vague():
                self._begin(form, middle_s)
                if self._taken_s == middle_s:  # it has begun
                    return None
        if not form.axes.all():  # The rest of the track is NumPy's.
            self._banks = [bank.in_numpy() for bank in self._banks]
        took = [bank.update(kept, seconds) for bank in self._banks]
        self._middle_s = middle_s
        if any(bank.broken for bank in self._banks):
            self._forget()
            self._precise = True
            return self._begin(form, middle_s)
        if any(took):
            self._taken_s = middle_s
            self._decide()
            self._judge(form, middle_s)
        elif self._banks[0].refused >= PATIENCE or gap_s > GAP_S:
            self._integrity.watch.alarm |= self._banks[0].refused >= PATIENCE
            self._begin(form, middle_s)
        elif self._banks[0].refused >= DOUBTED:
            self._leave_out(form)
        return None

    def _too_vague(self) -> bool:
        """Tell whether a gap has left so much open that a block is better located by itself."""
        known = self._banks[0].output()
        sd_m, sd_rad = (math.sqrt(float(np.trace(known.covariance[part, part]))) for part in (POSITION, TURN))
        near_m = float(self._model.nearest_m(known.motion.position_m[None])[0])
        return sd_m > VAGUE * near_m or sd_rad > VAGUE

    def _leave_out(self, form: NormalForm) -> None:
        """Leave out a beacon for which a block is refused, if it is taken without it."""
        pose, starts = self._starter.located(form, self._epoch, self._end_s, self._without)
        if not starts or not set(pose.excluded) - set(self._excluded):
            return
        self._excluded = pose.excluded
        kept = form.without(self._rows(self._out))
        if any([bank.update(kept, 0.0) for bank in self._banks]):
            self._taken_s = self._middle_s
            self._verdict = Verdict(pose, None, pose.excluded)
            self._integrity.forget()

    def _begin(self, form: NormalForm, middle_s: float) -> Pose:
        """Begin a track with a block, in place of one that there may be; return what the locator says."""
        pose, starts = self._starter.located(form, self._epoch, self._end_s, self._without)
        if starts:
            self._start(starts, middle_s)
            self._excluded = pose.excluded
            self._verdict = Verdict(pose, None, pose.excluded, pose.status is Status.INCONSISTENT)
        return pose

    def _start(self, starts: Sequence[Start], middle_s: float) -> None:
        """Begin a track, or several of which only one is right."""
        self._banks = [self._bank() for _ in starts]
        for bank, start in zip(self._banks, starts, strict=True):
            bank.start(start)
        self._middle_s = self._taken_s = self._heard_s = middle_s
        self._allowance.forget()
        self._track += 1
        self._starter.forget()
        self._integrity.forget()

    def _bank(self) -> Pair:
        return Pair(self._one_bank, self._model)

    def _one_bank(self) -> Bank | CBank:
        return CBank(self._model) if self._in_c and not self._precise else Bank(self._model)

    def _decide(self) -> None:
        """Give up starts that the blocks contradict; the likeliest comes first."""
        if len(self._banks) > 1:
            likely = sorted((bank for bank in self._banks if not bank.refused), key=lambda bank: bank.mismatch)
            self._banks = [bank for bank in likely if bank.mismatch - likely[0].mismatch < RIVAL]

    def _judge(self, form: NormalForm, middle_s: float) -> None:
        """Show the block to the integrity; follow its verdict."""
        known = self._banks[0].output()
        verdict = self._integrity.add(form, known, self._epoch, middle_s, self._out)
        alone = self._banks[0].by_beacons
        if alone is not None and form.axes.all():
            site = self._allowance.of_site(known.motion, self._rows(self._out))
            if site is not None:
                alone.covariance[:6, :6] += site
            self._evenness.update(self._integrity.ambient_T, alone, middle_s - self._judged_s)
            self._judged_s = middle_s
        if verdict is None:
            return
        self._verdict = verdict
        if not verdict.silent:
            self._heard_s = middle_s
        elif middle_s - self._heard_s > UNHEARD_S:
            self._forget()
            return
        before, self._excluded = self._excluded, verdict.excluded
        drawn = bool(set(verdict.excluded) - set(before))
        if not (verdict.inconsistent or verdict.silent) and (drawn or self._astray(verdict, known)):
            self._correct(verdict, middle_s)

    @staticmethod
    def _astray(verdict: Verdict, known: Estimate) -> bool:
        """Tell whether the track is somewhere else than where the cycle by itself has the sensor."""
        pose, motion = verdict.pose, verdict.motion
        if motion is None or pose.status is Status.AMBIGUOUS:
            return False
        apart = motion.position_m - pose.position_m
        both = known.covariance[POSITION, POSITION] + pose.position_cov_m2
        return float(apart @ np.linalg.solve(both, apart)) > ASTRAY

    def _correct(self, verdict: Verdict, middle_s: float) -> None:
        """Begin anew where the other beacons have the sensor: one that is now left out has drawn the track with it."""
        pose, before, now = verdict.pose, verdict.motion, self._banks[0].output()
        assert before is not None
        since_s = middle_s - pose.time_s
        turned = matrix_of(pose.orientation_xyzw)
        covariance = np.diag(np.repeat([(DRAWN_M_S * since_s) ** 2, (DRAWN_RAD_S * since_s) ** 2], 3))
        covariance[:3, :3] += WIDENED**2 * pose.position_cov_m2
        covariance[3:, 3:] += WIDENED**2 * pose.attitude_cov_rad2
        start = Start(
            pose.position_m + now.motion.position_m - before.position_m,
            now.motion.rotation @ before.rotation.T @ turned,
            covariance,
            now.motion.ambient_T,
            now.covariance[AMBIENT, AMBIENT] + AMBIENT_T**2 * np.eye(3),
        )
        self._start([start], middle_s)

    def _known(self, bank: Pair, time_s: float) -> Estimate:
        """Return what a bank believes of a moment, with what the errors of the site do to it."""
        known = bank.output(time_s - self._middle_s)
        self._blocks += 1
        anew = self._blocks % CONSIDERED == 0
        share = math.hypot(self._evenness.share, self._integrity.watch.share)
        return self._allowance.added_to(known, self._rows(self._out), share, anew)

    def _protection_m(self, verdict: Verdict, position_cov_m2: FloatArray) -> float:
        """Return the protection level of a position; between computations it grows with the deviation."""
        variance = float(np.trace(position_cov_m2))
        if self._level is None or self._level[0] is not verdict or self._blocks % CONSIDERED == 0:
            self._level = (verdict, verdict.protection_m(position_cov_m2), variance)
        _, level_m, before = self._level
        return level_m * math.sqrt(max(variance / before, 1.0))

    def _located(self, located: Pose | None) -> Pose:
        """Return the pose where there is no track: what the locator says, which nothing follows."""
        assert located is not None or self._verdict is None
        if located is None:
            nothing = Fields(self._epoch, self._end_s, (), np.empty((0, 3)), np.empty(0))
            return Pose.failed(nothing, reason="no beacon has been heard for a while")
        return located

    def _pose(self, time_s: float) -> Pose:
        """Return the pose of the track at a time."""
        poses = [self._told(bank, time_s) for bank in self._banks[:2]]
        if len(poses) == 1 or poses[0].status is Status.INCONSISTENT:
            return poses[0]
        reason = joined(poses[0].reason, "two poses fit the blocks so far")
        return replace(poses[0], status=Status.AMBIGUOUS, reason=reason, alternative=poses[1])

    def _told(self, bank: Pair, time_s: float) -> Pose:
        """Return a bank's pose with what the last verdict says of it."""
        verdict, out = self._verdict, self._out
        assert verdict is not None
        status, reason = Status.OK, None
        if verdict.excluded:
            reason = verdict.pose.reason or f"{', '.join(verdict.excluded)} left out, not as the site says"
        if verdict.inconsistent:
            status, reason = Status.INCONSISTENT, verdict.pose.reason
        elif verdict.silent:
            status, reason = Status.WEAK, f"no beacon has been heard for {self._middle_s - self._heard_s:.1f} s"
        if self._evenness.change_T:
            status = Status.UNVERIFIED if status is Status.OK else status
            reason = joined(
                reason,
                f"the ambient field has changed by {1e6 * self._evenness.change_T:.1f} uT: iron may bend the fields",
            )
        if self._integrity.watch.alarm:
            status = Status.INCONSISTENT
            reason = joined(reason, "the fields of the last blocks contradict the site")
        if bank.refused:
            text = "the last block contradicts" if bank.refused == 1 else f"the last {bank.refused} blocks contradict"
            reason = joined(reason, f"{text} the track: the pose is predicted")
            status = Status.INCONSISTENT if bank.refused >= DOUBTED else status
        known = self._known(bank, time_s)
        return self._reporter.pose(
            self._epoch,
            time_s,
            known,
            residual=verdict.pose.residual,
            status=status,
            used=() if bank.refused else tuple(name for name in self._row if name not in out),
            excluded=out,
            axes=self._axes,
            reason=reason,
            protection_m=self._protection_m(verdict, known.covariance[:3, :3]),
            residuals=verdict.pose.residuals,
            findings=verdict.pose.findings,
        )

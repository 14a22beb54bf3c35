"""Whether the sensor's blocks agree with the site: once a cycle, and as soon as they are far off.

A cycle is judged (`goldfield.track.blocks.judge`) while the next one comes, in another thread if there is one for it,
since that takes longer than a block. The verdict holds from a certain block on, whether it was there long before or
has to be waited for: poses depend on the blocks alone, and those of a replay are those of the live run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.site import Site
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.consider import Considered
from goldfield.track.blocks.equations import BlockEquations, NormalForm
from goldfield.track.blocks.judge import Cycle, Judge, Judged, Verdict
from goldfield.track.blocks.rest import cost_of, left_by
from goldfield.track.blocks.update import Reference
from goldfield.track.blocks.watch import Watch
from goldfield.types import FloatArray

QUICK = 4
"""With every so manieth block it is asked whether the fields are so far off that the cycle need not be waited for."""

FAR_OFF = 8.0
"""They are if their chi-square is so many standard deviations of chance above its mean, and above `TRACKED`."""

TRACKED = 30.0
"""What the error of the track may add to chi-square."""

USUAL = 3.0
"""And above so many times what the errors of the site have left in the last cycle."""

APPLIED = 6
"""A cycle's verdict holds from the block on that is a sixth of the cycle behind it: five blocks, 15 ms."""


class Integrity:
    """Judges what a track leaves of its blocks.

    Parameters
    ----------
    site : Site
    equations : BlockEquations
    aside : Executor, optional
        Where cycles are judged; None: where the blocks are taken.

    Attributes
    ----------
    watch : Watch
    ambient_T : ndarray, shape (3,)
        The ambient field of the last block that was added, in the sensor's frame.
    """

    def __init__(
        self, site: Site, equations: BlockEquations, considered: Considered, aside: Executor | None = None
    ) -> None:
        self._site, self._aside = site, aside
        self._model = FieldModel(site.beacons)
        self._judge = Judge(site, equations)
        self.watch = Watch(considered)
        self.ambient_T = np.zeros(3)
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        self._usual = 0.0
        self._pending: Callable[[], Judged] | None = None
        self._blocks_left = 0
        self._begin()

    def forget(self) -> None:
        """Begin a cycle anew; a verdict that does not hold yet is given up."""
        self._settled()
        self._begin()
        self.watch.forget()

    def add(
        self, form: NormalForm, known: Estimate, epoch: int, middle_s: float, without: Sequence[str]
    ) -> Verdict | None:
        """Add a block and what is known of its middle; return a verdict that holds from now on, once a cycle or sooner.

        A block that the track has refused is not to be added: it says nothing of the beacons. ``without`` are the
        beacons that the track leaves out.
        """
        rest = left_by(self._model, form, known, self._site.sensor.noise_T)
        self._blurs.append(rest.blur)
        self._rests.append(rest.form)
        self.ambient_T = rest.ambient_T
        self._references.append((rest.around, middle_s))
        rows = np.array([self._row[name] for name in without if name in self._row], dtype=np.intp)
        self.watch.add(rest.form, rest.blur, rest.around, rows)
        self._seconds += 2.0 * form.end_s + self._site.chip_period_s
        self._blocks_left -= 1
        verdict = self._settled() if self._blocks_left <= 0 else None
        count = len(self._rests)
        whole = self._seconds >= (1.0 - 0.5 / count) * self._site.cycle_s
        if not whole and (count % QUICK or not self._far_off(rows)):
            return verdict
        verdict = self._settled() or verdict
        self._blocks_left = count // APPLIED if whole else 0
        self._pending = self._judging(self._cycle(epoch, without, rows))
        self._begin()
        if self._blocks_left <= 0:
            verdict = self._settled() or verdict
        return verdict

    def _begin(self) -> None:
        """Begin a cycle."""
        self._rests: list[NormalForm] = []
        self._references: list[tuple[Reference, float]] = []
        self._blurs: list[FloatArray] = []
        self._seconds = 0.0

    def _cycle(self, epoch: int, without: Sequence[str], rows: NDArray[np.intp]) -> Cycle:
        """Return what the track has left of the blocks that there are."""
        around, middle_s = self._references[len(self._references) // 2]
        return Cycle(epoch, tuple(self._rests), tuple(self._blurs), around, middle_s, tuple(without), rows)

    def _judging(self, cycle: Cycle) -> Callable[[], Judged]:
        """Return what waits for the cycle's judgement, or makes it."""
        if self._aside is None:
            return partial(self._judge.judged, cycle)
        return self._aside.submit(self._judge.judged, cycle).result

    def _settled(self) -> Verdict | None:
        """Return the verdict that is pending, if there is one; from now on none is."""
        if self._pending is None:
            return None
        pending, self._pending = self._pending, None
        found = pending()
        self._usual = found.excess
        return found.verdict

    def _far_off(self, out: NDArray[np.intp]) -> bool:
        """Tell whether the fields of the last few blocks are far from what the site lets expect."""
        cost, freedom = cost_of([rest.without(out) for rest in self._rests[-QUICK:]], self._blurs[-QUICK:])
        limit = freedom + FAR_OFF * math.sqrt(2.0 * freedom) + TRACKED
        return cost > limit + USUAL * self._usual * QUICK

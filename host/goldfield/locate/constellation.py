"""The beacons that a sensor hears, and the search for its pose among them with no prior."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.budget import LEAST_EVALUATIONS
from goldfield.locate.chances import probability
from goldfield.locate.fault_statistics import fault_statistics
from goldfield.locate.field_shell_search import Shell, best_apart, profiled_attitude, profiled_loss
from goldfield.locate.fit import Fit, Measurements, fit_pose, stacked
from goldfield.locate.mirror import Mirror, Reach, find_mirrors
from goldfield.locate.silence import audible
from goldfield.locate.solutions import Solutions, nowhere, unsolved
from goldfield.locate.spread import Spread
from goldfield.locate.starts import MAGNITUDE_ERROR, SIMPLE_RANGE_ERROR, log_magnitudes, simple_magnitudes
from goldfield.locate.wahba import wahba
from goldfield.site import HalfSpace
from goldfield.types import FloatArray

ROBUST_MODEL_ERROR = 0.03
"""Model error of the first fit: wide enough to converge from the starts, narrow enough for the right valley."""

ROUGH_TOLERANCE = 1e-2
"""A fit that is only a start for the next ends when it has a tenth of a standard deviation to go."""

SUSPECT = 1e-3
"""A residual less likely than this makes the search look further: it costs time in one good epoch of a thousand."""

RIVAL_COST = 15.0
"""Another pose whose cost is within this of the best is a rival; e^7.5 = 1800 to one is the odds against it then."""

SURE_BEACONS = 6
"""Beacons that must stand out of the noise for the chain's answer to be taken without a search: fewer leave room for
several answers."""

OUTSTANDING = 7.0
"""A beacon stands out of the noise if its field is this many standard deviations strong."""

SURE_RADII = 1.5
"""Distance from every coil, in its radii, for the same: nearer the valleys of the cost bend."""

MOST_EVALUATIONS = LEAST_EVALUATIONS
"""Evaluations of the field that a search may take if the budget of an epoch allows; the median is 600, near coils
2,500."""

SECOND_EVALUATIONS = 4_000
"""The same for a search that a first one has called for: of the negated fields, or of those without a beacon."""

UNFIT, UNFIT_COMPONENT = 50.0, 5.0
"""Fields do not fit a pose whose cost, even with model error, exceeds the first and as much a component as the second:
sound data cost a component about 1."""

ROUGH_ITERATIONS = 40
"""Evaluations for such a fit."""

CANDIDATES = 8
"""Candidates of the shell that are fitted roughly; four times as many, and then all that the evaluations allow, where
the best of them is not likely: in a cube of eight coils some poses of a sensor with one axis need more than 128."""

CANDIDATE_EVALUATIONS = 20
"""Evaluations that such a fit takes."""

FITTED = 8
"""Those that are fitted to the end."""

MORE_ITERATIONS = 1000
"""Evaluations for a fit that has not converged as quickly as nearly all do: along a curved ridge near a coil."""

FLAT_REST = 0.05
"""The same as `goldfield.locate.mirror.FLAT` for what is left without a beacon: of what is less flat an image fits only
where hardly any beacon is heard, and to try the images of many costs more than to locate."""

REMEMBERED = 32
"""Subsets of beacons whose searches are kept ready: a few megabytes each once their shells were needed."""


class Constellation:
    """Beacons that are heard together.

    Parameters
    ----------
    model : FieldModel
    half_space : HalfSpace, optional
        Side of a plane where the sensor is known to be.
    shell : Shell, optional
        For the search without the kernel; made when first needed.
    """

    def __init__(self, model: FieldModel, half_space: HalfSpace | None = None, shell: Shell | None = None) -> None:
        self.model = model
        self.half_space = half_space
        self._shell = Shell(model) if shell is None else shell
        self._subsets: dict[bytes, Constellation] = {}

    @cached_property
    def mirrors(self) -> tuple[Mirror, ...]:
        """Maps of poses to others that may fit as well."""
        return find_mirrors(self.model)

    @cached_property
    def mirrors_without_one(self) -> tuple[tuple[int, Mirror], ...]:
        """The same of the others, more strictly, where one beacon, given by its row, is not looked at."""
        everyone = range(len(self.model))
        others = [self.model.subset(np.delete(everyone, row)) for row in everyone]
        return tuple((row, mirror) for row, model in enumerate(others) for mirror in find_mirrors(model, FLAT_REST))

    @cached_property
    def mirrors_reach(self) -> Reach:
        """What decides where these are worth a trial."""
        return Reach.of([mirror for _, mirror in self.mirrors_without_one])

    @cached_property
    def _spread(self) -> Spread:
        return Spread(self.model.centre_m)

    def subset(self, rows: NDArray[np.intp]) -> Constellation:
        """Return the constellation of some of the beacons; remembered."""
        key = np.asarray(rows, dtype=np.int64).tobytes()
        if key not in self._subsets:
            if len(self._subsets) >= REMEMBERED:
                self._subsets.clear()
            model = self.model.subset(rows)
            self._subsets[key] = Constellation(model, self.half_space, Shell(model, self._shell, rows))
        return self._subsets[key]

    def solve(
        self,
        measurements: Measurements,
        most_evaluations: int = MOST_EVALUATIONS,
        *,
        at_any_cost: bool = True,
        known: Fit | None = None,
    ) -> Solutions:
        """Find the poses of e epochs with no prior.

        The chain of magnitudes is quick, and its answer, or the poses that are ``known`` from elsewhere, is taken where
        it is shown to be right (`_enough`). Elsewhere the pose is searched: by the kernel, or for coils given by their
        wire and sensors without three axes in the shell of the strongest beacon. Where the fields are nothing but noise
        the cost is infinite. A search ends at ``most_evaluations``, or with the budget. Where fields fit nowhere the
        pose that fits best is searched, too, if it is wanted ``at_any_cost``.
        """
        heard = audible(measurements)
        most = measurements.affordable(len(self.model), most_evaluations)
        if heard.all():
            return self._solve_heard(measurements, most, at_any_cost, known)
        solutions = unsolved(nowhere(len(measurements)))
        rows = np.flatnonzero(heard)
        if len(rows):
            some = None if known is None else known.take(rows)
            solutions.put(rows, self._solve_heard(measurements.take(rows), most, at_any_cost, some))
        return solutions

    def _solve_heard(
        self, measurements: Measurements, most_evaluations: int, at_any_cost: bool, known: Fit | None
    ) -> Solutions:
        """Find the poses of epochs that are more than noise."""
        quick = kernel.of(self.model) if measurements.complete else None
        if known is not None:
            solutions = unsolved(known.take(np.arange(len(known.cost))))
        elif measurements.complete and len(self.model) >= (4 if quick is None else SURE_BEACONS):
            solutions = unsolved(self.from_magnitudes(measurements))
        else:
            solutions = unsolved(nowhere(len(measurements)))
        enough = self._enough(measurements, solutions.best, strict=quick is not None)
        if quick is not None and not enough.all():
            self._enough_without_one(measurements, solutions, enough)
        further = np.flatnonzero(~enough)
        if len(further) and quick is not None:
            solutions.put(further, self._search(measurements.take(further), most_evaluations, at_any_cost))
        else:
            for e in further:
                one = np.array([e])
                known = solutions.best.take(one)
                solutions.put(one, self._search_shell(measurements.take(one), known, most_evaluations))
        for mirror in self.mirrors:
            rows = np.flatnonzero(mirror.concerns(solutions.best.position_m))
            if len(rows):
                some = solutions.take(rows)
                self._reflect(measurements.take(rows), some, mirror)
                solutions.put(rows, some)
        return self._sided(solutions)

    def _enough(self, measurements: Measurements, fit: Fit, *, strict: bool) -> NDArray[np.bool_]:
        """Tell which fits, shape (e,), need no search: they fit, and if strict nothing else can."""
        enough = fit.converged & (probability(fit.cost, measurements.freedom) > SUSPECT)
        if strict and enough.any():
            enough &= self.sure(measurements, fit)
        return np.asarray(enough)

    def _enough_without_one(self, measurements: Measurements, solutions: Solutions, enough: NDArray[np.bool_]) -> None:
        """Spare the search of epochs, in place, that have one faulty beacon at most whose others allow no other pose.

        The beacon is the one that takes most off the cost of the pose that is known. The solution is then the pose that
        fits best near that of the others: whatever else fits all beacons would fit these.
        """
        outstanding = (measurements.magnitude_T > OUTSTANDING * measurements.sigma_T).sum(axis=1)
        wrong = solutions.best.converged & ~(probability(solutions.best.cost, measurements.freedom) > SUSPECT)
        some = np.flatnonzero(~enough & wrong & (outstanding > SURE_BEACONS))
        if not len(some):
            return
        given, known = measurements.take(some), solutions.best.take(some)
        drop = fault_statistics(self.model, given, known).drop
        thinned = given.without(drop == drop.max(axis=1, keepdims=True))
        others = self._polished(thinned, known.position_m, known.rotation)
        good = np.flatnonzero(self._enough(thinned, others, strict=True))
        if len(good):
            best = self._polished(given.take(good), others.position_m[good], others.rotation[good])
            found = best.converged
            solutions.put(some[good[found]], unsolved(best.take(np.flatnonzero(found))))
            enough[some[good[found]]] = True

    def sure(self, measurements: Measurements, fit: Fit) -> NDArray[np.bool_]:
        """Tell which fields that fit a pose, shape (e,), can fit no other.

        No other was found in trials where `SURE_BEACONS` stand out of the noise, no coil is near, and those beacons are
        neither near a line nor, for that distance, near a point (`Spread`).
        """
        outstanding = measurements.magnitude_T > OUTSTANDING * measurements.sigma_T
        distance = np.linalg.norm(fit.position_m[:, None] - self.model.centre_m, axis=2)
        sure = (outstanding.sum(axis=1) >= SURE_BEACONS) & (distance > SURE_RADII * self.model.reach_m).all(axis=1)
        rows = np.flatnonzero(sure)
        sure[rows] = self._spread.good(outstanding[rows], fit.position_m[rows])
        return np.asarray(sure)

    def searched(
        self, measurements: Measurements, most_evaluations: int, *, at_any_cost: bool
    ) -> tuple[FloatArray, FloatArray, NDArray[np.intp], FloatArray, NDArray[np.intp]] | None:
        """Search all of space for the poses of e epochs; None without the kernel, whose `Kernel.search` tells more."""
        quick = kernel.of(self.model)
        if quick is None:
            return None
        side = np.zeros(4)
        if self.half_space is not None:
            side = np.append(self.half_space.normal, self.half_space.normal @ self.half_space.point_m)
        most = measurements.affordable(len(self.model), most_evaluations)
        found = quick.search(
            measurements.field_T,
            measurements.sigma_T,
            half_space=side,
            most_evaluations=most,
            hopeless_cost=self.unfit,
            at_any_cost=at_any_cost,
        )
        measurements.spend(int(found[-1].sum()), len(self.model))
        return found

    @property
    def unfit(self) -> float:
        """Cost that sound fields do not reach."""
        return UNFIT + UNFIT_COMPONENT * 3 * len(self.model)

    def _search(self, measurements: Measurements, most_evaluations: int, at_any_cost: bool) -> Solutions:
        """Return the best poses of the search and their rivals, fitted to the end."""
        found = self.searched(measurements, most_evaluations, at_any_cost=at_any_cost)
        assert found is not None
        position, rotation, count, widening, evaluations = found
        unfit = self.unfit
        best = self._polished(measurements, position[:, 0], rotation[:, 0])
        self._further(measurements, best, np.flatnonzero(~best.converged & (best.cost < unfit)))
        solutions = unsolved(best)
        solutions.covariance_widening[:], solutions.evaluations[:] = widening, evaluations
        solutions.bounded[:] = (evaluations >= most_evaluations) | (~best.converged & (best.cost < unfit))
        two = np.flatnonzero(count == 2)
        if len(two):
            rival = self._polished(measurements.take(two), position[two, 1], rotation[two, 1])
            solutions.rival.put(two, rival)
            solutions.contested[two] = rival.cost - solutions.best.cost[two] < RIVAL_COST
        none = np.flatnonzero(count == 0)
        solutions.best.put(none, nowhere(len(none)))
        return solutions

    def _search_shell(self, measurements: Measurements, known: Fit, most_evaluations: int) -> Solutions:
        """Search the shell of one epoch, further if nothing likely is found; a pose that is known already competes."""
        most = most_evaluations // CANDIDATE_EVALUATIONS
        for candidates in sorted({CANDIDATES, min(4 * CANDIDATES, most), most}):
            found = self.from_shell(measurements, candidates)
            if not probability(found.cost[:1], measurements.freedom)[0] < SUSPECT:
                break
        found = self._distinct(_sorted(stacked([found, known])), measurements)
        solutions = unsolved(found.take(np.array([0])))
        if len(found.cost) > 1:
            solutions.rival.put(np.array([0]), found.take(np.array([1])))
            solutions.contested[0] = found.cost[1] - found.cost[0] < RIVAL_COST
        return solutions

    def from_magnitudes(self, measurements: Measurements) -> Fit:
        """Locate by the chain of magnitudes, which needs three axes and four beacons.

        The steps: positions from 1.5 k/r^3, then from log |B|, attitudes by Wahba's problem, a fit with model error,
        a fit without.
        """
        return self.refine(measurements, *self.starts(measurements))

    def starts(self, measurements: Measurements) -> tuple[FloatArray, FloatArray]:
        """Return positions, shape (e, 3), by magnitudes, and attitudes, shape (e, 3, 3), by Wahba's problem."""
        quick = kernel.of(self.model)
        if quick is not None:
            *start, evaluations = quick.starts(
                measurements.field_T,
                measurements.sigma_T,
                range_error=SIMPLE_RANGE_ERROR,
                magnitude_error=MAGNITUDE_ERROR,
                vector_error=ROBUST_MODEL_ERROR,
            )
            measurements.spend(evaluations, len(self.model))
            return start[0], start[1]
        magnitude, sigma, known = measurements.magnitude_T, measurements.sigma_T, measurements.known
        position = simple_magnitudes(self.model, magnitude, sigma, known)
        position = log_magnitudes(self.model, magnitude, sigma, known, position)
        weight = measurements.inverse_sigma(ROBUST_MODEL_ERROR)[:, 0] ** 2
        return position, wahba(self.model.field(position), measurements.filled_T, weight)

    def from_shell(self, measurements: Measurements, candidates: int = CANDIDATES) -> Fit:
        """Search the shell of one epoch and fit its best candidates; the best comes first."""
        field, sigma = measurements.field_T[0], measurements.sigma_T[0]
        position, modelled = self._shell.candidates(field)
        loss = np.where(self.inside(position), profiled_loss(modelled, field, sigma), np.inf)
        apart = 2.0 / candidates * np.linalg.norm(position[:, None] - self.model.centre_m, axis=2).min(axis=1)
        best = best_apart(position, loss, candidates, apart)
        if not len(best):
            return nowhere(1)
        rotation = profiled_attitude(modelled[best], field, sigma)
        rough = self._rough(measurements.take(np.zeros(len(best), dtype=np.intp)), position[best], rotation)
        rough = _sorted(rough).take(np.arange(min(len(best), FITTED)))
        repeated = measurements.take(np.zeros(len(rough.cost), dtype=np.intp))
        return _sorted(self._polished(repeated, rough.position_m, rough.rotation))

    def refine(self, measurements: Measurements, position_m: FloatArray, rotation: FloatArray) -> Fit:
        """Fit from a rough start: first with model error, then without."""
        rough = self._rough(measurements, position_m, rotation)
        return self._polished(measurements, rough.position_m, rough.rotation)

    def _rough(self, measurements: Measurements, position_m: FloatArray, rotation: FloatArray) -> Fit:
        """Fit with model error, only so far that the stiff fit can go on."""
        return fit_pose(
            self.model,
            measurements,
            position_m,
            rotation,
            model_error=ROBUST_MODEL_ERROR,
            iterations=ROUGH_ITERATIONS,
            tolerance=ROUGH_TOLERANCE,
        )

    def _polished(self, measurements: Measurements, position_m: FloatArray, rotation: FloatArray) -> Fit:
        """Fit without model error."""
        return fit_pose(self.model, measurements, position_m, rotation)

    def _further(self, measurements: Measurements, fit: Fit, rows: NDArray[np.intp]) -> None:
        """Fit some of the poses with more iterations, in place."""
        if len(rows):
            position, rotation = fit.position_m[rows], fit.rotation[rows]
            some = measurements.take(rows)
            fit.put(rows, fit_pose(self.model, some, position, rotation, iterations=MORE_ITERATIONS))

    def at(self, measurements: Measurements, position_m: FloatArray, rotation: FloatArray) -> Fit:
        """Return cost and information at given poses, not fitted."""
        return fit_pose(self.model, measurements, position_m, rotation, iterations=0)

    def inside(self, position_m: FloatArray) -> NDArray[np.bool_]:
        """Tell which positions, shape (e, 3), are in the half-space; all if there is none."""
        if self.half_space is None:
            return np.ones(len(position_m), dtype=bool)
        return np.asarray((position_m - self.half_space.point_m) @ self.half_space.normal >= 0.0)

    def _distinct(self, fits: Fit, measurements: Measurements) -> Fit:
        """Drop poses that are the same as a better one, and those outside if there is one inside; the best first."""
        finite = np.isfinite(fits.cost)
        allowed = finite & self.inside(fits.position_m)
        order = np.flatnonzero(allowed if allowed.any() else finite)
        axes = measurements.measured[0].any(axis=0)
        kept: list[int] = []
        for i in order:
            near = 0.05 * np.linalg.norm(fits.position_m[i] - self.model.centre_m, axis=1).min()
            pointing = fits.rotation[i][:, axes]
            if not any(
                np.linalg.norm(fits.position_m[i] - fits.position_m[k]) < near
                and np.abs(pointing - fits.rotation[k][:, axes]).max() < 0.2
                for k in kept
            ):
                kept.append(int(i))
        return fits.take(np.array(kept if kept else [0], dtype=np.intp))

    def _reflect(self, measurements: Measurements, solutions: Solutions, mirror: Mirror) -> None:
        """Try the images of poses: the side where the sensor must be decides, else they are rivals.

        The solutions are changed in place.
        """
        best, rival, contested = solutions.best, solutions.rival, solutions.contested
        image = mirror.image(best)
        if mirror.exact:
            other = mirror.image(rival)
            better = np.flatnonzero(contested & ~self.inside(rival.position_m) & self.inside(other.position_m))
            rival.put(better, other.take(better))
        else:
            image = self.refine(measurements, image.position_m, image.rotation)
        apart = np.linalg.norm(image.position_m - best.position_m, axis=1) > 1e-3
        apart |= np.abs(image.rotation - best.rotation).max(axis=(1, 2)) > 0.2
        likely = apart & (image.cost - best.cost < RIVAL_COST)
        here, there = self.inside(best.position_m), self.inside(image.position_m)
        swap = np.flatnonzero(likely & np.where(here == there, image.cost < best.cost, there))
        kept = best.take(swap)
        best.put(swap, image.take(swap))
        image.put(swap, kept)
        solutions.covariance_widening[swap] = mirror.reflected(solutions.covariance_widening[swap])
        open_rows = np.flatnonzero(likely & (here == there))
        rival.put(open_rows, image.take(open_rows))
        contested[open_rows] = True

    def _sided(self, solutions: Solutions) -> Solutions:
        """Let the half-space decide between rivals."""
        if self.half_space is None:
            return solutions
        best, rival, contested = solutions.best, solutions.rival, solutions.contested
        right, other = self.inside(best.position_m), self.inside(rival.position_m)
        swap = np.flatnonzero(contested & ~right & other)
        kept = best.take(swap)
        best.put(swap, rival.take(swap))
        rival.put(swap, kept)
        decided = contested & (right != other)
        outside = ~(right | (contested & other))
        return replace(solutions, contested=contested & ~decided, outside=outside)


def _sorted(fits: Fit) -> Fit:
    return fits.take(np.argsort(np.where(np.isfinite(fits.cost), fits.cost, np.inf)))

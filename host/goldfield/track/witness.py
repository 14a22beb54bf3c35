"""The history of the residuals as a witness: which beacon is no longer as the site says, and where it fits better.

A single epoch does not see a beacon that was moved by 2 cm; twenty epochs do. Each epoch's `Judgement` leaves of the
fields what no pose explains. A beacon that is off by d has the field -G d more, G its gradient at the sensor, so that
each epoch adds to a linear least squares for d: h = E'F'r and H = E'(F'SF)E with E = -R'G, over the last epochs, the
poses of all of them free. sum(h)' sum(H)^-1 sum(h) is chi-square with three degrees of freedom if the
beacon is where the site says; one that is only as exact as its survey is granted that. So is what the hum of the mains
leaves in its field, which stays the same from cycle to cycle as no noise does (`goldfield.access.hum`). Another current
gives the same for one unknown. The pose does not know of it, so a beacon that was left out of the pose is watched in
the same way.
What the last epochs deny, as after a single bad one, is not believed: with d from a longer time, d'Hd - 2 d'h of a
shorter one is the cost of d beside that of no error. It falls with each epoch that has the error and rises with each
that has it no more, so that an error is forgotten after one to three times as many good epochs as it takes to see it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.access.hum import hum_deviations
from goldfield.field import FieldModel
from goldfield.locate.chances import chdtri
from goldfield.locate.sensor_axes import axes_of
from goldfield.site import Site
from goldfield.track.faults import Judgement, judged
from goldfield.types import Explanation, Finding, FloatArray

RECENT_S, PATIENT_S = 2.0, 10.0
"""Times over which the residuals are added up: a large error shows soon, a smaller one to patience."""

STARTS, EARLIER_STARTS = 20, 6
"""Moments within the shorter time, and between it and the longer, from which they are added up, too. The sum that shows
an error best begins where the error began: Page's cumulative sum with the size not known."""

FALSE_ALARMS_PER_HOUR = 0.01
"""Permitted rate of beacons that are named though all are as the site says."""

KEPT = 0.5
"""A beacon that is named stays so as long as it explains more of the cost than this part of what it takes to be named:
chance does not let it come and go."""

DENIED = 1.0 / 3.0
"""The last epochs deny an error if it costs them more than this part of what it takes to be named, and if they
themselves show less than that: chance does this to an error that is there in at most 6 of 100,000 sums."""

CLEAR = 12.0
"""A beacon is named only if it explains more of the cost than any other, by this; else none is."""

LARGEST = 4.0
"""Nor is it named if another beacon's own part of the cost is larger by so many standard deviations of chance."""

SIMPLER = 12.0
"""A current that explains as much as a place, less this, is the better explanation: it has two unknowns less."""

UNEXPLAINED = 1e-6
"""If what is left of a beacon's cost has less than this probability, neither place nor current explains it."""
UNEXPLAINED_SHARE = 0.2
"""Nor do they if this part of its cost is left: the field is linear only near the place that the site gives."""

NEIGHBOURS = 2.0
"""Errors of the survey, and what hum leaves, show at a beacon up to so much larger than its own, through the pose and
its neighbours."""

LINEAR_M = 0.05
"""Beyond such a shift the field is no longer linear in it, and is computed anew."""
REFINEMENTS = 5
FARTHEST_M = 1e3
"""A beacon that would have to be moved so far is not explained by a move: its field there is none."""
SETTLED_M = 1e-4
LEAST_INFORMATION = 1e-9
"""Eigenvalues of the information below this part of the largest are rounding."""

FIXED = 0.3
"""A place is told if its standard deviation along the worst axis is below this part of the shift, or 2 cm."""


NUMBERS = 27
"""Numbers in the evidence of a beacon."""


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What epochs say together of each of n beacons, as numbers that add up, shape (..., n, `NUMBERS`)."""

    numbers: FloatArray

    @property
    def place(self) -> FloatArray:
        """h, shape (..., n, 3)."""
        return self.numbers[..., :3]

    @property
    def place_information(self) -> FloatArray:
        """H, shape (..., n, 3, 3)."""
        return self.numbers[..., 3:12].reshape(*self.numbers.shape[:-1], 3, 3)

    @property
    def current(self) -> FloatArray:
        """What h is for the current, shape (..., n)."""
        return self.numbers[..., 12]

    @property
    def current_information(self) -> FloatArray:
        """What H is for the current, shape (..., n)."""
        return self.numbers[..., 13]

    @property
    def drop(self) -> FloatArray:
        """Cost of each beacon, shape (..., n)."""
        return self.numbers[..., 14]

    @property
    def freedom(self) -> FloatArray:
        """Degrees of freedom of the cost, shape (..., n)."""
        return self.numbers[..., 15]

    @property
    def epochs(self) -> FloatArray:
        """Number of epochs, shape (..., n), the same for each beacon."""
        return self.numbers[..., 16]

    @property
    def mean_distance_m(self) -> FloatArray:
        """Mean distance from the sensor, shape (..., n)."""
        return np.asarray(self.numbers[..., 17] / self.epochs)

    @property
    def place_by_field(self) -> FloatArray:
        """What a field that is off by 1 T in each epoch adds to h, shape (..., n, 3, 3)."""
        return self.numbers[..., 18:].reshape(*self.numbers.shape[:-1], 3, 3)


class Witness:
    """Watches the beacons of a site by what a sensor's epochs leave unexplained.

    Parameters
    ----------
    site : Site

    Attributes
    ----------
    finding : Finding or None
        What is known at the moment: the one beacon that is not as the site says, ``moved`` (with its position, if the
        epochs tell it), ``current``, ``reversed``, ``dead``, or ``beacon`` if nothing so simple explains it, as with
        metal near it.
    """

    def __init__(self, site: Site) -> None:
        self.finding: Finding | None = None
        self._site = site
        self._or_metal = "" if site.metal is None else "; or metal was moved since it was learned ([metal])"
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        self._centres = FieldModel(site.beacons).centre_m
        recent, patient = (max(round(seconds / site.cycle_s), 1) for seconds in (RECENT_S, PATIENT_S))
        starts = np.linspace(1, recent, STARTS).round().astype(int).tolist()
        earlier = np.geomspace(recent, patient, EARLIER_STARTS + 1).round().astype(int).tolist()
        self._windows: NDArray[np.intp] = np.array(sorted({*starts, *earlier}))
        self._recent: deque[Judgement] = deque(maxlen=recent)
        # Sums from the first epoch on: those of the last epochs in a ring, zeros where there were none yet
        self._totals = np.zeros((self._windows[-1] + 1, len(site.beacons), NUMBERS))
        self._place = 0
        level = FALSE_ALARMS_PER_HOUR * site.cycle_s / 3600.0 / len(site.beacons) / len(self._windows)
        self._limit = float(chdtri(3.0, level))
        surveys = [beacon.survey for beacon in site.beacons]
        self._tolerance2 = np.array([survey.position_sd_m**2 for survey in surveys])
        self._tolerance2_by_distance2 = np.array(
            [(0.5 * survey.axis_sd_rad) ** 2 + (survey.current_sd / 3.0) ** 2 for survey in surveys]
        )
        axes = axes_of(site.sensor)  # which read the hum as they read all else
        self._hum2_T2 = (NEIGHBOURS * hum_deviations(site) * (1.0 if axes is None else axes.noise_ratio)) ** 2
        self._wait = 0

    @property
    def named(self) -> tuple[str, ...]:
        """Id of the beacon that is not as the site says, if there is one."""
        return () if self.finding is None else self.finding.beacons

    def update(self, judgement: Judgement | None) -> Finding | None:
        """Add an epoch; without a judgement, as of one that has no pose, nothing is learned. Return ``finding``."""
        if judgement is None:
            return self.finding
        self._recent.append(judgement)
        windows = self._with(self._evidence(judgement))
        if self.finding is None and self._unsuspicious(windows):
            return None
        plain, granted = self._costs(windows)
        found = self._suspect(windows, plain, granted)
        self._wait -= 1
        if found is None:
            if self.finding is not None and granted[:, self._row[self.named[0]]].max() <= KEPT * self._limit:
                self._forget()
                self.finding = None
        elif self.named != (self._site.beacons[found[0]].id,) or self._wait <= 0:
            self.finding = self._explained(*found)
            self._wait = int(found[1].epochs[0])
        return self.finding

    def _with(self, evidence: _Evidence) -> _Evidence:
        """Add an epoch's evidence; return that of all windows, which lead its shape."""
        last, self._place = self._place, (self._place + 1) % len(self._totals)
        self._totals[self._place] = self._totals[last] + evidence.numbers
        return _Evidence(self._totals[self._place] - self._totals[self._place - self._windows])

    def _forget(self) -> None:
        """Let the sums of all beacons begin anew: what good epochs have denied must not come up again.

        It would as soon as another beacon fails, whose error shows in the shorter windows of all, too. Two that lead
        the time one after the other and lose their power would both be blamed.
        """
        self._totals[:] = self._totals[self._place]

    def _evidence(self, judgement: Judgement) -> _Evidence:
        along, slope = judgement.field_T, judgement.gradient_T_m.swapaxes(1, 2)  # E' = -slope
        through = slope @ judgement.information
        own = (judgement.information @ along[:, :, None])[:, :, 0]
        told = np.empty((len(along), NUMBERS))
        told[:, :3] = -(slope @ judgement.score[:, :, None])[:, :, 0]
        told[:, 3:12] = (through @ judgement.gradient_T_m).reshape(-1, 9)
        told[:, 12] = (along * judgement.score).sum(axis=1)
        told[:, 13] = (along * own).sum(axis=1)
        told[:, 14] = judgement.drop
        told[:, 15] = judgement.drop_freedom
        told[:, 18:] = -through.reshape(-1, 9)
        numbers = np.zeros((len(self._row), NUMBERS))
        numbers[[self._row[name] for name in judgement.beacons]] = told
        numbers[:, 16] = 1.0
        numbers[:, 17] = np.linalg.norm(self._centres - judgement.state.position_m, axis=1)
        return _Evidence(numbers)

    def _unsuspicious(self, windows: _Evidence) -> bool:
        """Tell quickly that no beacon can be named, as in nearly all epochs of a sound site.

        With `LEAST_INFORMATION` of H's trace, r, on the diagonal each part of the granted cost, along one eigenvector,
        is lowered, but not below half, since those with eigenvalues below r do not count in `_costs`: the cost that
        is granted is at most twice the one that is computed here.
        """
        information = windows.place_information
        tolerance2 = self._granted_m2(windows.mean_distance_m)
        weakened = information + tolerance2[..., None, None] * (information @ information) + self._by_hum(windows)
        trace = np.einsum("...kk", information)
        weakened += (LEAST_INFORMATION * trace + 1e-300)[..., None, None] * np.eye(3)
        place = windows.place
        cost = (place * np.linalg.solve(weakened, place[..., None])[..., 0]).sum(axis=-1)
        return bool(2.0 * cost.max() <= self._limit)

    def _costs(self, windows: _Evidence) -> tuple[FloatArray, FloatArray]:
        """Return what each beacon takes away from the cost of each window, plain and granted, shape (windows, n).

        Granted is what is left of the plain one for a beacon that is only as exact as its survey, beside the hum. Both
        are 0 for an error that the epochs of a shorter window deny.
        """
        tolerance2 = self._granted_m2(windows.mean_distance_m)
        information = windows.place_information
        values, vectors = np.linalg.eigh(information)
        seen = values > LEAST_INFORMATION * np.maximum(values[..., -1:], 1e-300)
        values = np.where(seen, values, 1.0)
        along = np.where(seen, np.einsum("wnck,wnc->wnk", vectors, windows.place), 0.0)
        plain = (along**2 / values).sum(axis=2)
        by_hum = vectors.swapaxes(2, 3) @ self._by_hum(windows) @ vectors
        spread = np.where(seen[..., :, None] & seen[..., None, :], by_hum, 0.0)
        spread += np.eye(3) * (values + tolerance2[:, :, None] * values**2)[..., None]
        granted = (along * np.linalg.solve(spread, along[..., None])[..., 0]).sum(axis=2)
        shown, current = windows.current_information, windows.current
        plain = np.maximum(plain, np.where(shown > 0.0, current**2 / np.where(shown > 0.0, shown, 1.0), 0.0))
        shift = np.einsum("wnck,wnk->wnc", vectors, along / values)
        beside = np.einsum("wni,vnij,wnj->wvn", shift, information, shift)
        beside -= 2.0 * np.einsum("wni,vni->wvn", shift, windows.place)
        limit = DENIED * self._limit
        shorter = np.tri(len(self._windows), k=-1, dtype=bool)[:, :, None]
        denied = (shorter & (beside > limit) & (granted <= limit)).any(axis=1)
        return np.where(denied, 0.0, plain), np.where(denied, 0.0, granted)

    def _by_hum(self, windows: _Evidence) -> FloatArray:
        """Return the covariance of h by what the hum leaves in each beacon's field, shape (..., n, 3, 3)."""
        if not self._hum2_T2.any():
            return np.zeros((3, 3))
        by_field = windows.place_by_field
        return np.asarray(self._hum2_T2[:, None, None] * (by_field @ by_field.swapaxes(-1, -2)))

    def _suspect(self, windows: _Evidence, plain: FloatArray, granted: FloatArray) -> tuple[int, _Evidence] | None:
        """Return the row of the beacon that is not as the site says and the window that shows it best; None if none."""
        largest = granted.max(axis=1)
        place = int(np.argmax(largest[:-1])) if len(largest) > 1 else 0  # cycles of minutes have one window
        if largest[place] <= self._limit:
            place = len(largest) - 1
        of, row = _Evidence(windows.numbers[place]), int(np.argmax(plain[place]))
        clear = plain[place, row] > np.delete(plain[place], row).max(initial=0.0) + CLEAR
        clear = clear and of.drop[row] > of.drop.max() - LARGEST * np.sqrt(2.0 * of.freedom[row])
        return (row, of) if clear and granted[place, row] > self._limit else None

    def _granted_m2(self, distance_m: FloatArray) -> FloatArray:
        """Return the square of how far the survey lets beacons at mean distances, shape (..., n), appear to be off."""
        return np.asarray(NEIGHBOURS**2 * (self._tolerance2 + self._tolerance2_by_distance2 * distance_m**2))

    def _explained(self, row: int, of: _Evidence) -> Finding:
        """Say what explains the fields of a beacon best."""
        beacon = self._site.beacons[row]
        whole, freedom = float(of.drop[row]), float(of.freedom[row])
        shown = float(of.current_information[row])
        part = float(of.current[row]) / shown if shown > 0.0 else 0.0
        by_current = part**2 * shown
        information = of.place_information[row]
        shift = np.linalg.pinv(information, rcond=LEAST_INFORMATION, hermitian=True) @ of.place[row]
        deviation_m = 1.0 / np.sqrt(max(float(np.linalg.eigvalsh(information)[0]), 1e-30))
        by_place = float(shift @ of.place[row])
        if np.linalg.norm(shift) > LINEAR_M:
            shift, share = self._refined(row, shift, int(of.epochs[0]))
            by_place = share * whole
        left = whole - max(by_place, by_current)
        if left > chdtri(max(freedom - 3.0, 1.0), UNEXPLAINED) and left > UNEXPLAINED_SHARE * whole:
            text = (
                f"{beacon.id} is not as the site says, and neither a move nor its current explains it: metal near it?"
                f"{self._or_metal}"
            )
            return Finding(Explanation.BEACON, (beacon.id,), text)
        if by_current > by_place - SIMPLER:
            return strength_finding(beacon.id, 1.0 + part)
        far = float(np.linalg.norm(shift))
        if deviation_m > max(FIXED * far, 0.02):
            text = f"{beacon.id} was moved: the epochs do not tell where to{self._or_metal}"
            return Finding(Explanation.MOVED, (beacon.id,), text)
        place = beacon.position_m + shift
        where = ", ".join(f"{value:.3f}" for value in place)
        text = f"{beacon.id}: its position fits better at {where} m, {100.0 * far:.1f} cm from where the site has it"
        text += self._or_metal
        return Finding(Explanation.MOVED, (beacon.id,), text, position_m=place)

    def _refined(self, row: int, shift: FloatArray, epochs: int) -> tuple[FloatArray, float]:
        """Fit the shift of a beacon to its fields, computed anew with it moved, over so many epochs or `RECENT_S`.

        Return it with the share of the beacon's cost that it takes away.
        """
        beacon = self._site.beacons[row]
        recent = list(self._recent)[-epochs:]
        whole = max(sum(float(self._evidence(one).drop[row]) for one in recent), 1e-300)
        best, explained = shift, 0.0
        for _ in range(REFINEMENTS):
            if not np.linalg.norm(shift) < FARTHEST_M:
                break
            placed = replace(beacon, position_m=beacon.position_m + shift, points_m=_moved(beacon.points_m, shift))
            total = _Evidence(np.zeros((len(self._row), NUMBERS)))
            for one in recent:
                old = one.observation
                model = FieldModel([placed if other.id == beacon.id else other for other in old.model.beacons])
                now = self._evidence(judged(replace(old, model=model), one.state, one.prior))
                total = _Evidence(total.numbers + now.numbers)
            share = 1.0 - float(total.drop[row]) / whole
            if share > explained:
                best, explained = shift, share
            inverse = np.linalg.pinv(total.place_information[row], rcond=LEAST_INFORMATION, hermitian=True)
            step = inverse @ total.place[row]
            if np.linalg.norm(step) < SETTLED_M:
                break
            shift = shift + step
        return best, explained


def strength_finding(name: str, factor: float) -> Finding:
    """Say what is wrong with a beacon whose field is a factor times the site's."""
    if abs(factor) < 0.1:
        return Finding(Explanation.DEAD, (name,), f"{name} has no field: check its coil and its power", factor=0.0)
    if factor < -0.5:
        text = f"the field of {name} is reversed: check the coil's wires"
        return Finding(Explanation.REVERSED, (name,), text, factor=factor)
    text = f"the field of {name} is {factor:.3g} times the site's: check its current"
    return Finding(Explanation.CURRENT, (name,), text, factor=factor)


def _moved(points_m: FloatArray | None, shift: FloatArray) -> FloatArray | None:
    return None if points_m is None else points_m + shift

"""What a block tells, in one form for every kind of site: sums on its templates and their Gram matrices.

`BlockEquations` knows a site: its templates, the codes that a sensor board correlates with, and the sensor's axes. It
turns a `Block`, of samples or of sums, into a `NormalForm`, which is all that the filter, the start and the integrity
take (docs/blocks.md, "Data").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from goldfield.access.gold import code_matrix
from goldfield.access.waveform import site_templates
from goldfield.errors import UserError
from goldfield.site import Site
from goldfield.site.drive import NO_CODE
from goldfield.types import LARGEST_T, Block, FloatArray

REMEMBERED = 1100
"""Blocks whose matrices are kept: a cycle of degree 10 has 1023 places to begin."""

PIVOT = 1e-9
"""Eigenvalues of a Gram matrix below this part of its largest are rounding: such columns depend on others."""

SEPARABLE = 1e-3
"""Eigenvalues of a Gram matrix, its diagonal scaled to 1, from which on its fields are told apart."""


@dataclass(frozen=True, eq=False)
class Alone:
    """The matrices of a block whose ambient field is unknown; ``reduced`` brings the sums of the whole block there."""

    reduced: FloatArray
    gram: FloatArray
    moment: FloatArray


@dataclass(frozen=True, eq=False)
class NormalForm:
    """A block as the filter takes it: S = G0 h + G1 h' + noise, for n beacons and, last, the ambient field.

    The noise of the sums has the covariance ``gram`` between rows and the inverse of ``weight`` between components.

    Attributes
    ----------
    sums_T : ndarray, shape (n + 1, 3)
        Components in the sensor's frame; 0 along what was not measured.
    gram, moment : ndarray, shape (n + 1, n + 1)
        C' C, and C' diag(tau) C with the times from the middle of the block, s. Zero for a beacon that is left out.
    ramp : ndarray, shape (n + 1,)
        What the columns take of the times, s: `ramp_of`.
    weight : ndarray, shape (3, 3)
        Inverse covariance of a sample's components in the sensor's frame, 1/T^2; of less rank if axes are missing.
    end_s : float
        Time from the middle of the block to its last sample.
    axes : ndarray of bool, shape (3,)
        Axes of the sensor that were measured.
    alone : Alone, optional
        The matrices of `beacons_alone`, if they are known.
    """

    sums_T: FloatArray
    gram: FloatArray
    moment: FloatArray
    ramp: FloatArray
    weight: FloatArray
    end_s: float
    axes: NDArray[np.bool_]
    alone: Alone | None = None

    def beside_ambient(self, matrix: FloatArray) -> FloatArray:
        """Return the rows of the beacons of a matrix, or of the sums, if the ambient field is unknown."""
        share = self.gram[:-1, -1] / self.gram[-1, -1]
        return np.asarray(matrix[:-1] - share[:, None] * matrix[-1])

    def with_sums(self, sums_T: FloatArray) -> NormalForm:
        """Return the same block with other sums."""
        return NormalForm(
            sums_T, self.gram, self.moment, self.ramp, self.weight, self.end_s, self.axes, self.alone
        )  # in place of `replace`, which takes ten times as long

    def without(self, rows: NDArray[np.intp]) -> NormalForm:
        """Return what the block tells of the others if the fields of some beacons are unknown."""
        if not len(rows):
            return self
        kept = np.ones(len(self.gram), dtype=bool)
        kept[rows] = False
        across = np.zeros_like(self.gram)
        out = np.ix_(rows, rows)
        across[:, rows] = self.gram[:, rows] @ np.linalg.pinv(self.gram[out], rcond=PIVOT, hermitian=True)
        across[rows] = 0.0
        both = np.outer(kept, kept)
        gram = np.where(both, self.gram - across @ self.gram, 0.0)
        moment = np.where(both, self.moment - across @ self.moment, 0.0)
        sums = np.where(kept[:, None], self.sums_T - across @ self.sums_T, 0.0)
        return replace(self, sums_T=sums, gram=gram, moment=moment, ramp=ramp_of(gram, moment), alone=None)

    @property
    def beacons_alone(self) -> NormalForm:
        """What the block tells if the ambient field is unknown, and how fast it changes evenly."""
        known = self.alone
        if known is None:
            known = _alone(self.gram, self.moment, self.ramp, self.end_s)
        sums = known.reduced @ self.sums_T
        ramp = np.zeros(len(sums))
        return NormalForm(sums, known.gram, known.moment, ramp, self.weight, self.end_s, self.axes)

    def scaled(self, factors: FloatArray) -> NormalForm:
        """Return what the block tells of fields of which the sensor gets some factors, shape (n,), as much."""
        each = np.append(factors, 1.0)
        both = np.outer(each, each)
        gram, moment = both * self.gram, both * self.moment
        sums = each[:, None] * self.sums_T
        return replace(self, sums_T=sums, gram=gram, moment=moment, ramp=ramp_of(gram, moment), alone=None)


def _alone(gram: FloatArray, moment: FloatArray, ramp: FloatArray, end_s: float) -> Alone:
    """Project the ambient field out of a block's matrices, and that it changes evenly, if the columns take the time."""
    last = len(gram) - 1
    both = np.stack([gram[last], moment[:, last]])  # F' G0
    share = np.stack([np.eye(1, last + 1, last)[0], ramp])  # F'
    if not share[1] @ both[1] > SEPARABLE * end_s**2:
        both, share = both[:1], share[:1]
    reduced = np.eye(last + 1) - np.linalg.solve(share @ both.T, both).T @ share
    gram, moment = reduced @ gram, reduced @ moment
    reduced[last] = 0.0
    for matrix in (gram, moment):  # what is left there is rounding
        matrix[last] = matrix[:, last] = 0.0
    return Alone(reduced, gram, moment)


def ramp_of(gram: FloatArray, moment: FloatArray) -> FloatArray:
    """Return the shares of the columns that together come nearest to the time from the middle of the block.

    A field that changes evenly leaves them in the sums, each column as if it had a field of its own: this is how a
    block tells of the turn rate by the sweep of the ambient field.
    """
    return np.asarray(np.linalg.pinv(gram, rcond=PIVOT, hermitian=True) @ moment[:, -1])


@dataclass(frozen=True, eq=False)
class _Columns:
    """The matrices of the blocks that begin at one chip; ``reduced`` brings sums or samples to the normal form."""

    reduced: FloatArray
    gram: FloatArray
    moment: FloatArray
    ramp: FloatArray
    end_s: float

    @cached_property
    def alone(self) -> Alone:
        """The matrices of `NormalForm.beacons_alone`."""
        return _alone(self.gram, self.moment, self.ramp, self.end_s)

    def form(self, sums_T: FloatArray, weight: FloatArray, axes: NDArray[np.bool_]) -> NormalForm:
        """Return a block of some sums."""
        return NormalForm(sums_T, self.gram, self.moment, self.ramp, weight, self.end_s, axes, self.alone)


ALL: NDArray[np.bool_] = np.ones(3, dtype=bool)
ALL.flags.writeable = False
"""All three axes of a sensor."""


class BlockEquations:
    """Makes the normal forms of a site's blocks.

    Parameters
    ----------
    site : Site

    Attributes
    ----------
    columns : ndarray, shape (N, n + 1)
        Templates of the beacons, and ones.

    Raises
    ------
    UserError
        If the site is of a kind that no block filter can follow: `check_followed`.
    """

    def __init__(self, site: Site) -> None:
        check_followed(site)
        self._site = site
        ones = np.ones((site.chips, 1))
        self.columns: FloatArray = np.hstack([site_templates(site), ones])
        self._codes: FloatArray | None = None
        if all(beacon.code != NO_CODE for beacon in site.beacons):
            self._codes = np.hstack([code_matrix(site.degree, site.codes).astype(np.float64), ones])
        sensor = site.sensor
        self._axes = np.eye(3) if sensor.axes is None else sensor.axes
        ratio = np.ones(len(self._axes)) if sensor.noise_ratio is None else sensor.noise_ratio
        self._noise_T = sensor.noise_T * ratio
        self._known: dict[tuple[int, int, bool], _Columns] = {}
        self._heads: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def form(self, block: Block) -> NormalForm | None:
        """Return the normal form of a block; None if it holds no data.

        Samples of which a component is missing are left out, an axis that has none is not measured.

        Raises
        ------
        UserError
            If the shape of the data is not that of so many chips or codes, the first chip is none of the cycle, or
            sums come for a site whose beacons have not one plain code each.
        """
        data = self._checked(block)
        if len(self._axes) == 3 and np.abs(data).max() <= LARGEST_T:  # all is there, as nearly always
            columns, (components, weight) = self._columns(block.chip, block.chips, block.sampled), self._read(ALL)
            return columns.form((columns.reduced @ data) @ components.T, weight, ALL)
        usable = np.asarray(np.abs(data) <= LARGEST_T)
        axes: NDArray[np.bool_] = np.asarray(usable.any(axis=0))
        axes[len(self._axes) :] = False
        if not axes.any():
            return None
        rows: NDArray[np.bool_] = np.asarray(usable[:, axes].all(axis=1))
        if rows.all():
            columns = self._columns(block.chip, block.chips, block.sampled)
        elif block.sampled and rows.any():
            columns = self._of_some(block.chip, block.chips, rows)
            data = data[rows]
        else:
            return None
        components, weight = self._read(axes)
        sums = (columns.reduced @ data[:, axes]) @ components.T
        return columns.form(sums, weight, axes)

    @property
    def cycle(self) -> NormalForm:
        """A whole cycle without data: what its chips weigh, by all axes of the sensor."""
        axes = np.arange(3) < len(self._axes)
        count = self.columns.shape[1]
        gram = self.columns.T @ self.columns
        return NormalForm(
            np.zeros((count, 3)), gram, np.zeros_like(gram), np.zeros(count), self._read(axes)[1], 0.0, axes
        )

    def readings(self, components_T: FloatArray, axes: NDArray[np.bool_]) -> FloatArray:
        """Return what the sensor's axes read of components, both of shape (n, 3); NaN on axes not measured."""
        result = np.full(components_T.shape, np.nan)
        result[:, : len(self._axes)] = components_T @ self._axes.T
        result[:, ~axes] = np.nan
        return result

    def _checked(self, block: Block) -> FloatArray:
        """Return the data of a block that is as the type says."""
        codes = self._codes
        if not block.sampled and codes is None:
            self._site.codes  # noqa: B018  (says which beacon has no plain code)
        rows = block.chips if block.sampled or codes is None else codes.shape[1]
        data = np.asarray(block.data_T, dtype=np.float64)
        if block.chips < 1 or data.shape != (rows, 3):
            what = "samples, one a chip" if block.sampled else "sums, one a code and the plain one"
            raise UserError(
                f"data_T= of Block has the shape {data.shape}: {block.chips} chips need ({rows}, 3), {what}"
            )
        if not 0 <= block.chip < self._site.chips:
            raise UserError(f"chip= of Block is {block.chip}: the cycle has the chips 0 to {self._site.chips - 1}")
        return data

    def _columns(self, chip: int, chips: int, sampled: bool) -> _Columns:
        key = (chip, chips, sampled)
        known = self._known.get(key)
        if known is None:
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            known = self._known[key] = self._of_some(chip, chips, None, sampled)
        return known

    def _of_some(self, chip: int, chips: int, rows: NDArray[np.bool_] | None, sampled: bool = True) -> _Columns:
        """Compute the matrices, of all samples or of some of them."""
        place = (chip + np.arange(chips)) % self._site.chips
        tau = (np.arange(chips) - 0.5 * (chips - 1)) * self._site.chip_period_s
        end_s = float(tau[-1])
        if rows is not None:
            place, tau = place[rows], tau[rows]
        columns = self.columns[place]
        late = tau[:, None] * columns
        if sampled or self._codes is None:
            gram, moment = columns.T @ columns, columns.T @ late
            return _Columns(columns.T.copy(), gram, moment, ramp_of(gram, moment), end_s)
        codes = self._codes[place]
        through = codes.T @ columns
        back = through.T @ np.linalg.pinv(codes.T @ codes, rcond=PIVOT, hermitian=True)
        gram, moment = back @ through, back @ (codes.T @ late)
        return _Columns(back, gram, moment, ramp_of(gram, moment), end_s)

    def _read(self, axes: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Return what makes components of the readings of some axes, shape (3, k), and the weight of a sample's."""
        key = axes.tobytes()
        if key not in self._heads:
            taken = axes[: len(self._axes)]
            rows, noise = self._axes[taken], self._noise_T[taken]
            whitened = rows / noise[:, None]
            self._heads[key] = np.asarray(np.linalg.pinv(rows), dtype=np.float64), whitened.T @ whitened
        return self._heads[key]


def check_followed(site: Site) -> None:
    """Check that the samples of a site's beacons are known at each chip, and that the sensor reads at one point.

    Raises
    ------
    UserError
        If they are not.
    """
    if site.sensor.lever_m is not None:
        raise UserError(
            f"site {site.name}: poses from blocks take all axes of the sensor to be at one point, but [sensor] has "
            "lever_m: locate whole cycles, or leave out lever_m if it is small"
        )
    if any(beacon.drive.frequency_Hz is not None for beacon in site.beacons):
        raise UserError(
            f"site {site.name}: poses from blocks need each beacon's signal at each chip, but the phases of its tones "
            'are unknown: locate whole windows, or give tones of phase = "known"'
        )


@dataclass(frozen=True, eq=False)
class Separated:
    """The fields of some successive blocks, each block with an ambient field of its own.

    Attributes
    ----------
    field_T : ndarray, shape (n, 3)
        Components in the sensor's frame; NaN for beacons that these blocks do not tell from others.
    deviation : ndarray, shape (n,)
        Deviations of the fields, over that of a sample.
    sweep_s : ndarray, shape (n, n + 1)
        What ramps of the fields, and last of the ambient field, within each block add to the fields, T for 1 T/s.
    """

    field_T: FloatArray
    deviation: FloatArray
    sweep_s: FloatArray


def separated(forms: Sequence[NormalForm], blur: FloatArray | None = None) -> Separated:
    """Separate the fields of some blocks, or of what a motion leaves of them, as if the sensor stood still.

    Parameters
    ----------
    forms : sequence of NormalForm
    blur : ndarray, shape (n,), optional
        Variance of the beacons' sums beside that of the noise, over a sample's variance.
    """
    found = _solved(*_with_own_ambient(forms), blur)
    if len(forms) > 1 and not np.isfinite(found.deviation).all():
        other = _solved(*_with_ramp(forms), blur)
        if np.isfinite(other.deviation).sum() > np.isfinite(found.deviation).sum():
            return other
    return found


def _with_own_ambient(forms: Sequence[NormalForm]) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix of the beacons' fields, and right sides, if each block has an ambient field of its own.

    The right sides, shape (n, n + 4), are the three of the sums and those of the moments.
    """
    gram = np.array([form.gram for form in forms])
    share = (gram[:, :-1, -1] / gram[:, -1:, -1])[..., None]
    sums, moment = np.array([form.sums_T for form in forms]), np.array([form.moment for form in forms])
    left, *right = ((part[:, :-1] - share * part[:, -1:]).sum(axis=0) for part in (gram, sums, moment))
    return left[:, :-1], np.hstack(right)


def _with_ramp(forms: Sequence[NormalForm]) -> tuple[FloatArray, FloatArray]:
    """Return the same if the ambient field goes on in a straight line: signals that do not change within a block.

    The line goes through the middles of the blocks; what it does within them is taken out by its slope.
    """
    chips, span_s = forms[-1].gram[-1, -1], 2.0 * forms[-1].end_s
    block_s = span_s * chips / max(chips - 1.0, 1.0)
    middles_s = block_s * (np.arange(len(forms)) - 0.5 * (len(forms) - 1))
    right = np.array([np.hstack([form.sums_T, form.moment]) for form in forms])
    gram = np.array([form.gram for form in forms])
    powers = np.stack([np.ones(len(forms)), middles_s / middles_s[-1]], axis=1)
    across = np.einsum("bi,bk->ik", gram[:, :-1, -1], powers)
    inner = np.linalg.pinv(np.einsum("b,bk,bl->kl", gram[:, -1, -1], powers, powers))
    left = gram[:, :-1, :-1].sum(axis=0) - across @ inner @ across.T
    plain = np.einsum("bk,bc->kc", powers, right[:, -1])
    rest = right[:, :-1].sum(axis=0) - across @ inner @ plain
    fields = np.linalg.pinv(left, rcond=SEPARABLE, hermitian=True) @ rest[:, :3]
    slope = (inner @ (plain[:, :3] - across.T @ fields))[1] / middles_s[-1]
    rest[:, :3] -= np.outer(rest[:, -1], slope)
    rest[:, -1] = 0.0
    return left, rest


def _solved(gram: FloatArray, right: FloatArray, blur: FloatArray | None) -> Separated:
    """Solve for the fields that are told apart."""
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale[scale < PIVOT * scale.max(initial=0.0)] = np.inf
    scale[scale == 0.0] = np.inf
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    seen = values > SEPARABLE
    known = (vectors[:, ~seen] ** 2).sum(axis=1) < SEPARABLE
    part = vectors[:, seen] / scale[:, None]
    inverse = (part / values[seen]) @ part.T
    solved = inverse @ right
    variance = np.diag(inverse)
    if blur is not None:
        variance = variance + (inverse * inverse) @ blur
    deviation = np.sqrt(variance)
    return Separated(np.where(known[:, None], solved[:, :3], np.nan), np.where(known, deviation, np.inf), solved[:, 3:])

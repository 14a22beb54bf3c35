"""Separation for a moving sensor, whose fields change during a cycle (maths.md, 4).

While the sensor moves, its samples are y[t] = sum_i c_i[t] h_i(tau) + e(tau) + noise: the fields h_i of the beacons and
the ambient field e in the sensor's frame turn and change during the cycle. tau is the time from the middle of the
cycle; sample t is taken at the end of chip t.

- `DriftSeparator`: columns for a ramp and a curve of the ambient field beside the codes. A turning sensor sweeps the
  earth's field, hundreds of times a beacon's, over its axes; codes do not cancel a ramp.
- `Cycle`: the fields as polynomials through a few nodes of the cycle. Then every linear processing of the samples is a
  small matrix on the fields at the nodes: `Cycle.seen` gives it for weights of any kind.
- `Reduction`: a whole cycle of samples as a few uncorrelated numbers that hold all that the samples say of the fields
  at the nodes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from goldfield.access.cdma import Separation
from goldfield.access.gold import code_matrix
from goldfield.errors import UserError
from goldfield.types import FloatArray

SAMPLE_PHASE = 1.0
"""Place in its chip, from 0 to 1, at which a sample is taken: at the end, when the coils have settled."""

RANK_TOLERANCE = 1e-9
"""Least diagonal of a triangular factor, relative to its largest: dependent codes leave rounding there."""


def sample_times(chips: int) -> FloatArray:
    """Return the times of the samples from the middle of the cycle in units of the cycle, shape (N,): -1/2 to 1/2."""
    return np.asarray((np.arange(chips) + SAMPLE_PHASE) / chips - 0.5)


def node_times(nodes: int) -> FloatArray:
    """Return the Chebyshev points of the cycle, from its middle in units of the cycle, shape (k,)."""
    return np.asarray(-0.5 * np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes))


def separation_weights(
    degree: int, codes: Sequence[int], drift: int = 0, templates: FloatArray | None = None
) -> FloatArray:
    """Return the samples' weights in the separated fields and, last, the ambient field at mid-cycle: (n + 1, N).

    Least squares on the codes and the powers 0 to ``drift`` of time. With templates of coils that follow slowly, shape
    (N, n), the same sums of the samples, so solved that fields and powers at rest come out right: as
    `goldfield.access.cdma.Separator` does with what a sensor sends.

    Raises
    ------
    UserError
        If the columns depend on each other.
    """
    times = sample_times((1 << degree) - 1)
    powers = (2.0 * times[:, None]) ** np.arange(drift + 1)
    columns = np.hstack([code_matrix(degree, codes).astype(np.float64), powers])
    orthogonal, triangle = np.linalg.qr(columns)
    diagonal = np.abs(np.diag(triangle))
    if len(triangle) < columns.shape[1] or diagonal.min() <= RANK_TOLERANCE * diagonal.max():
        raise UserError(
            f"the {len(codes)} codes cannot be separated beside an ambient field that changes during the cycle "
            f"(order {drift}): leave out beacons or choose other codes"
        )
    weights = np.linalg.solve(triangle, orthogonal.T)
    if templates is not None:
        weights = np.linalg.solve(weights @ np.hstack([templates, powers]), weights)
    return np.asarray(weights[: len(codes) + 1])


class DriftSeparator:
    """Separates cycles of a fixed set of codes from an ambient field that is a polynomial of time.

    Parameters
    ----------
    degree : int
    codes : sequence of int
    noise_T : float
        Standard deviation of one sample on one axis.
    drift : int
        Order of the polynomial: 2 takes out ramp and curve, for 0.1 % more noise; 0 is `Separator`.

    Raises
    ------
    UserError
        If the codes cannot be told apart; see `separation_weights`.
    """

    def __init__(self, degree: int, codes: Sequence[int], noise_T: float, drift: int = 2) -> None:
        self._weights = separation_weights(degree, codes, drift)
        self._sigma_T = noise_T * np.sqrt((self._weights**2).sum(axis=1))

    def from_samples(self, samples_T: FloatArray) -> Separation:
        """Separate one cycle of complete samples, shape (N, 3); an axis with a NaN is not measured."""
        middle = samples_T.mean(axis=0)
        separated = self._weights @ (samples_T - middle)
        measured = bool(np.isfinite(separated).any())
        sigma = self._sigma_T[:-1] if measured else np.full(len(self._sigma_T) - 1, np.inf)
        return Separation(separated[:-1], separated[-1] + middle, sigma)


class Cycle:
    """The fields of one cycle as polynomials through the fields at a few moments, the nodes.

    Parameters
    ----------
    degree : int
    codes : sequence of int
    nodes : int
        3 for separated fields, which average over the cycle; 7 holds 3e-6 of a field over 0.1 m at 0.3 m.
    templates : ndarray, shape (N, n), optional
        What the samples hold of each beacon (`goldfield.access.waveform`); default: the codes.

    Attributes
    ----------
    times : ndarray, shape (k,)
        Times of the nodes from mid-cycle, in units of the cycle: Chebyshev points.
    design : ndarray, shape (N, (n + 1) k)
        Samples by field at node: n beacons, then the ambient field; the node runs fastest.
    """

    def __init__(self, degree: int, codes: Sequence[int], nodes: int, templates: FloatArray | None = None) -> None:
        chips = (1 << degree) - 1 if templates is None else len(templates)
        self.times: FloatArray = node_times(nodes)
        basis = _lagrange(self.times, sample_times(chips))
        if templates is None:
            templates = code_matrix(degree, codes).astype(np.float64)
        carriers = np.hstack([templates, np.ones((chips, 1))])
        self.design: FloatArray = (carriers[:, :, None] * basis[:, None, :]).reshape(chips, -1)

    def seen(self, weights: FloatArray) -> FloatArray:
        """Return what weighted sums of the samples, weights of shape (m, N), see of the nodes: (m, (n + 1) k)."""
        return np.asarray(weights @ self.design)


class Reduction:
    """Turns the samples of a cycle into uncorrelated numbers of unit variance, with no loss.

    Parameters
    ----------
    cycle : Cycle
    noise_T : float
        Standard deviation of one sample on one axis.

    Attributes
    ----------
    seen : ndarray, shape (r, (n + 1) k)
        What the r numbers see of the fields at the nodes, 1/T.

    Notes
    -----
    With the design of the cycle = Q T, the numbers are Q' times the samples and T is what they see. What is left out is
    noise whatever the motion. About 10 ms once for a set of codes; 0.1 ms a cycle.
    """

    def __init__(self, cycle: Cycle, noise_T: float) -> None:
        orthogonal, triangle = np.linalg.qr(cycle.design)
        self._rows: FloatArray = orthogonal.T / noise_T
        self.seen: FloatArray = triangle / noise_T

    def numbers(self, data_T: FloatArray) -> FloatArray:
        """Reduce samples, shape (N, 3), to numbers, shape (r, 3); NaN on an axis with a NaN."""
        return np.asarray(self._rows @ data_T)


def _lagrange(nodes: FloatArray, times: FloatArray) -> FloatArray:
    """Return Lagrange's polynomials of the nodes, shape (k,), at the times, shape (N,): shape (N, k)."""
    result = np.ones((len(times), len(nodes)))
    for k, node in enumerate(nodes):
        for other in np.delete(nodes, k):
            result[:, k] *= (times - other) / (node - other)
    return result

"""Time constants and polarity of coils, from raw samples of a sensor at rest.

After an edge a coil's current follows its drive as 1 - exp(-t / tau), so that the sample at the end of a chip sees
f[n] = e f[n-1] + (1 - e) c[n] of the drive c, with e = exp(-T / tau) and chips of T. Fields and e of all beacons are
found together by least squares over the whole cycle, the samples of all cycles averaged. A polarity is right or wrong
together with those of other coils: fields r_i = s_i R' B_i of signs s_i have products r_i . r_j = s_i s_j B_i . B_j,
so that the signs are those of the leading eigenvector of the matrix of both products multiplied; whether all are
reversed is told by the attitude, which must be a rotation and no reflection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.access.waveform import site_templates
from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.site import Site
from goldfield.types import Explanation, Fields, FloatArray, Status

ComplexArray = NDArray[np.complex128]

STEPS = 8
"""Gauss-Newton steps: the problem is nearly linear, four suffice."""
STEP = 1e-4
"""Change of e with which the derivative of a template is taken."""
LARGEST_REMAINDER = math.exp(-0.1)
"""Largest e: a time constant of ten chips, as in a site file."""
SEEN = 3.0
"""Deviations from zero from which on a time constant is told, else only what it is below."""
HEARD, EXACT = 6.0, 1e-9
"""Size of a field over its noise, and over the largest sample, that at least one beacon must exceed."""
FEWEST_SIGNED = 3
"""Beacons from which on the attitude tells whether all are reversed."""
CLEAR = 0.5
"""Largest misfit of an attitude, as a part of the fields, with which polarities are told."""


@dataclass(frozen=True, eq=False)
class CoilCalibration:
    """What was found of one beacon.

    Attributes
    ----------
    beacon : str
    field_T : ndarray, shape (3,)
        What the sensor reads of it at full current.
    tau_s : float
        Time constant; 0 if none is seen.
    tau_sd_s : float or None
        Standard deviation; None where it is not seen.
    tau_below_s : float
        What the time constant is below, at two deviations.
    reversed : bool or None
        Whether the moment is opposite to what the site says; None: it cannot be told.
    """

    beacon: str
    field_T: FloatArray
    tau_s: float
    tau_sd_s: float | None
    tau_below_s: float
    reversed: bool | None


def calibrate_coils(site: Site, samples_T: FloatArray, place_m: FloatArray | None = None) -> list[CoilCalibration]:
    """Calibrate the coils of a site.

    Parameters
    ----------
    site : Site
        Its ``tau_s`` are ignored.
    samples_T : ndarray, shape (cycles, N, 3)
        Samples at the ends of the chips, sensor's frame, at rest; NaN where one is missing.
    place_m : ndarray, shape (3,), optional
        Where the sensor stands; else its pose is sought, which one coil of unknown polarity leaves possible.

    Raises
    ------
    UserError
        If the site's access tells nothing of time constants, or samples are missing in all cycles.
    """
    if site.access == "fdma":
        raise UserError('coils driven by tones show no edges: with access = "fdma" time constants cannot be found')
    samples = np.nanmean(samples_T, axis=0) if np.isfinite(samples_T).any(axis=0).all() else samples_T[0]
    if not np.isfinite(samples).all():
        raise UserError("some chips are missing in every cycle: record more cycles")
    fields, remainders, deviations, noise_T = _rises(site_templates(site, rise=False), samples)
    _check_heard(fields, samples, noise_T)
    signs = _signs(site, fields, noise_T, place_m)
    result = []
    for row, beacon in enumerate(site.beacons):
        e, sd = float(remainders[row]), float(deviations[row])
        seen = e > SEEN * sd
        tau = _tau(e) if seen else 0.0
        result.append(
            CoilCalibration(
                beacon.id,
                fields[row],
                site.chip_period_s * tau,
                site.chip_period_s * sd * tau**2 / e if seen else None,
                site.chip_period_s * _tau(max(e, 0.0) + 2.0 * sd),
                None if signs is None or signs[row] == 0.0 else bool(signs[row] < 0.0),
            )
        )
    return result


def _check_heard(fields: FloatArray, samples_T: FloatArray, noise_T: float) -> None:
    """Refuse samples in which no beacon is heard: what is found in a constant or in noise is nobody's."""
    least = max(HEARD * noise_T / math.sqrt(len(samples_T)), EXACT * float(np.abs(samples_T).max()))
    if not float(np.linalg.norm(fields, axis=1).max()) > least:
        raise UserError(
            "no beacon is heard in the samples: check that the beacons run, and that the site file has their codes"
        )


def _tau(remainder: float) -> float:
    """Return the time constant, in chips, that leaves so much of a step after one; at most ten."""
    return -1.0 / math.log(min(max(remainder, 1e-300), LARGEST_REMAINDER))


def _followed(spectrum: ComplexArray, remainder: FloatArray) -> FloatArray:
    """Return the periodic solution of f[n] = e f[n-1] + (1 - e) c[n], shape (N, n), of spectra of drives, (N, n)."""
    back = np.exp(-2j * np.pi * np.arange(len(spectrum)) / len(spectrum))[:, None]
    return np.asarray(np.fft.ifft(spectrum * (1.0 - remainder) / (1.0 - remainder * back), axis=0).real)


def _rises(drives: FloatArray, samples_T: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return fields, shape (n, 3), remainders e and their deviations, shape (n,), and the noise of a sample."""
    chips, count = drives.shape
    spectrum = np.fft.fft(drives, axis=0)
    remainder: FloatArray = np.full(count, 0.05)
    for _ in range(STEPS):
        template, slope = _template(spectrum, remainder)
        columns = np.hstack([template, np.ones((chips, 1))])
        fields: FloatArray = np.asarray(np.linalg.lstsq(columns, samples_T, rcond=None)[0], dtype=np.float64)
        residual = (samples_T - columns @ fields).T.ravel()
        jacobian = _jacobian(columns, slope, fields[:count])
        change = np.linalg.lstsq(jacobian, residual, rcond=None)[0][-count:]
        remainder = np.clip(remainder + change, -0.5, LARGEST_REMAINDER)
    freedom = max(residual.size - jacobian.shape[1], 1)
    noise_T = float(np.sqrt(residual @ residual / freedom))
    triangle = np.linalg.qr(jacobian, mode="r")
    inverse = np.linalg.pinv(triangle)
    deviation = np.asarray(noise_T * np.sqrt((inverse[-count:] ** 2).sum(axis=1)), dtype=np.float64)
    return fields[:count], remainder, deviation, noise_T


def _template(spectrum: ComplexArray, remainder: FloatArray) -> tuple[FloatArray, FloatArray]:
    here = _followed(spectrum, remainder)
    return here, (_followed(spectrum, remainder + STEP) - here) / STEP


def _jacobian(columns: FloatArray, slope: FloatArray, fields: FloatArray) -> FloatArray:
    """Return the derivatives of all samples, axis by axis, by fields and offset of each axis, then by each e."""
    own = np.kron(np.eye(3), columns)
    rise = np.concatenate([slope * fields[:, axis] for axis in range(3)])
    return np.hstack([own, rise])


def _signs(site: Site, fields: FloatArray, noise_T: float, place_m: FloatArray | None) -> FloatArray | None:
    """Return 1 for each beacon that is as the site says, -1 for one that is reversed, 0 where unknown; None: all."""
    if place_m is None:
        return _signs_of_pose(site, fields, noise_T)
    expected = FieldModel(site.beacons).field(place_m)
    unit_found, unit_expected = (
        vectors / np.linalg.norm(vectors, axis=1, keepdims=True) for vectors in (fields, expected)
    )
    products = (unit_found @ unit_found.T) * (unit_expected @ unit_expected.T)
    np.fill_diagonal(products, 0.0)
    signs = np.where(np.linalg.eigh(products)[1][:, -1] >= 0.0, 1.0, -1.0)
    if len(fields) < FEWEST_SIGNED:
        return None
    misfits = {sign: _misfit(sign * signs[:, None] * unit_found, unit_expected) for sign in (1.0, -1.0)}
    best = min(misfits, key=lambda sign: misfits[sign])
    return best * signs if misfits[best] < CLEAR * min(1.0, misfits[-best]) else None


def _misfit(found: FloatArray, expected: FloatArray) -> float:
    """Return what the best rotation leaves between unit vectors, root mean square."""
    left, _, right = np.linalg.svd(expected.T @ found)
    proper = np.diag([1.0, 1.0, float(np.linalg.det(left @ right))])
    return float(np.sqrt(np.mean(np.sum((found @ (left @ proper @ right).T - expected) ** 2, axis=1))))


def _signs_of_pose(site: Site, fields: FloatArray, noise_T: float) -> FloatArray | None:
    """Return the signs if the fields tell a pose at an unknown place, perhaps with one reversed beacon."""
    names = tuple(beacon.id for beacon in site.beacons)
    sigma = np.full(len(fields), noise_T / math.sqrt(site.chips))
    pose = Locator(site).locate(Fields(0, 0.0, names, fields, sigma))
    reversed_ones = {
        name for finding in pose.findings if finding.kind is Explanation.REVERSED for name in finding.beacons
    }
    if reversed_ones:
        return np.array([-1.0 if name in reversed_ones else 1.0 for name in names])
    if pose.status in (Status.OK, Status.UNVERIFIED):
        return np.array([1.0 if name in pose.used else 0.0 for name in names])
    return None

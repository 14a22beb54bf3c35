"""Ways to tell beacons apart, compared on equal terms (patent US 6,691,074, "Overview and Advantages").

N beacons share a cycle of samples. Each system is its templates and the exact separation of them; every figure follows
from the weights W of that separation (fields = W samples), none from a random draw. Errors are in parts of a field
whose drive peaks at 1 (equal peak current), or whose drive has a mean square of 1 (equal average power).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goldfield.access.cdma import plain_correlation
from goldfield.access.gold import code_matrix
from goldfield.access.linear import TemplateAccess
from goldfield.access.nuisance import Nuisance, constant, mains
from goldfield.access.rise import LAGS, filtered, lagged, sharpened
from goldfield.access.waveform import slot_template, tone_template
from goldfield.errors import UserError
from goldfield.types import FloatArray


@dataclass(frozen=True)
class Setup:
    """What all systems of a comparison have in common.

    Attributes
    ----------
    beacons : int
    degree : int
        A cycle has ``2**degree - 1`` samples, one at the end of each chip.
    cycle_s : float
    mains_Hz : float
    mains_error_Hz : float
        Error by which the mains columns miss the true frequency.
    conductor_chips : float
        Time constant of a nearby conductor in chips.
    """

    beacons: int = 100
    degree: int = 10
    cycle_s: float = 0.1
    mains_Hz: float = 60.0
    mains_error_Hz: float = 0.1
    conductor_chips: float = 0.3

    @property
    def chips(self) -> int:
        """Samples in a cycle, N."""
        return (1 << self.degree) - 1

    @property
    def chip_s(self) -> float:
        """Duration of a chip."""
        return self.cycle_s / self.chips


@dataclass(frozen=True)
class Figures:
    """What a system makes of disturbances, at equal peak current; all but the names are numbers without unit or dB.

    Attributes
    ----------
    system : str
    power : float
        Mean square of a drive that peaks at 1, mean over the beacons.
    noise : float
        Standard deviation of a field for white noise of 1 a sample, root mean square over the beacons.
    noise_spread : float
        The noisiest beacon over the quietest.
    mains_rms_dB, mains_worst_dB : float
        Error through a hum of the mains frequency over the hum itself, both as root mean square over its phase; root
        mean square over the beacons, and of the worst beacon.
    impulse : float
        Error through one sample that is wrong by 1, for the worst sample; mean over the beacons.
    earth : float
        Error through a constant field of 1, worst beacon.
    below_chip_rate : float
        Part of the energy of the drive, without its mean, at frequencies below the chip rate; mean over the beacons.
    changes : float
        Part of the chips at whose begin the current changes; mean over the beacons.
    eddy, eddy_spread : float
        Error of a beacon's own field through a conductor: root mean square and the largest over the smallest magnitude.
        The conductor answers each step of the drive with a field of the step's size that decays with its time constant
        (the energy of the derivative of a square wave is infinite: what counts is what is left at the samples).
    """

    system: str
    power: float
    noise: float
    noise_spread: float
    mains_rms_dB: float
    mains_worst_dB: float
    impulse: float
    earth: float
    below_chip_rate: float
    changes: float
    eddy: float
    eddy_spread: float

    @property
    def peak(self) -> float:
        """Peak of a drive whose mean square is 1: at equal average power errors are smaller by this."""
        return float(self.power**-0.5)


def systems(setup: Setup) -> list[Figures]:
    """Compare TDMA without and with a quiet slot, FDMA, CDMA, and CDMA with columns for the mains.

    Raises
    ------
    UserError
        If a system has no room for so many beacons.
    """
    chips = setup.chips
    slots = slot_drives(setup)
    codes = code_drives(setup)
    offset = constant(chips)
    missed = mains(chips, setup.chip_s, setup.mains_Hz + setup.mains_error_Hz)
    return [
        figures("TDMA, no quiet slot", slots, [], setup),
        figures("TDMA + quiet slot", slots, [offset], setup),
        figures("FDMA", tone_drives(setup), [offset], setup),
        figures("CDMA", codes, [offset], setup),
        figures("CDMA + mains columns", codes, [offset, missed], setup),
    ]


def slot_drives(setup: Setup) -> FloatArray:
    """Return pulses of direct current, one slot a beacon and one that stays quiet, shape (N, n)."""
    slots = setup.beacons + 1
    if slots > setup.chips:
        raise UserError(f"{setup.beacons} beacons and a quiet slot have no room in {setup.chips} chips: compare fewer")
    return np.stack([slot_template(setup.chips, slots, slot) for slot in range(setup.beacons)], axis=1)


def tone_drives(setup: Setup) -> FloatArray:
    """Return tones of 1, 2, ... whole periods in a cycle, without the one nearest to the mains, shape (N, n)."""
    highest = (setup.chips - 1) // 2
    periods = [k for k in range(1, highest + 1) if k != round(setup.mains_Hz * setup.cycle_s)]
    if setup.beacons > len(periods):
        raise UserError(f"{setup.beacons} beacons are more than the {len(periods)} tones of {setup.chips} samples")
    return np.stack([tone_template(setup.chips, k) for k in periods[: setup.beacons]], axis=1)


def code_drives(setup: Setup) -> FloatArray:
    """Return balanced Gold codes, shape (N, n): of those the earth's field leaks least into plain correlations."""
    family = code_matrix(setup.degree, range(setup.chips)).astype(np.float64)
    balanced = family[:, family.sum(axis=0) == -1.0]
    if setup.beacons > balanced.shape[1]:
        raise UserError(
            f"{setup.beacons} beacons are more than the {balanced.shape[1]} balanced codes of degree {setup.degree}"
        )
    return np.asarray(balanced[:, : setup.beacons])


def figures(system: str, drives: FloatArray, nuisances: Sequence[Nuisance], setup: Setup) -> Figures:
    """Return the figures of one system, from its drives, shape (N, n), and the nuisances that it estimates."""
    count = drives.shape[1]
    access = TemplateAccess([f"{index + 1}" for index in range(count)], drives, nuisances, 1.0)
    weights = access.weights[:count]
    noise = np.sqrt((weights**2).sum(axis=1))
    phase = 2.0 * np.pi * setup.mains_Hz * setup.chip_s * (np.arange(len(drives)) + 1.0)
    hum = np.abs(weights @ np.exp(1j * phase))
    own = np.diag(weights @ conductor(drives, setup.conductor_chips))
    return Figures(
        system=system,
        power=float((drives**2).mean()),
        noise=_rms(noise),
        noise_spread=float(noise.max() / noise.min()),
        mains_rms_dB=_dB(_rms(hum)),
        mains_worst_dB=_dB(float(hum.max())),
        impulse=float(np.abs(weights).max(axis=1).mean()),
        earth=float(np.abs(weights.sum(axis=1)).max()),
        below_chip_rate=float(below_chip_rate(drives).mean()),
        changes=float((np.abs(drives - np.roll(drives, 1, axis=0)) > 1e-12).mean()),
        eddy=_rms(own),
        eddy_spread=float(np.abs(own).max() / np.abs(own).min()),
    )


def conductor(drives: FloatArray, conductor_chips: float) -> FloatArray:
    """Return the secondary field at the ends of the chips, shape (N, n).

    It is d[n] = e (d[n-1] + c[n] - c[n-1]) with e = exp(-T / tau), the first-order high-pass that belongs
    to the coil's low-pass: drive minus filtered drive.
    """
    return np.asarray(drives - filtered(drives, conductor_chips))


def below_chip_rate(drives: FloatArray) -> FloatArray:
    """Return the part of the energy of each drive below the chip rate, shape (n,).

    The drive is held during its chips and taken without its mean.

    The lines of a held sequence are those of its discrete transform times sinc(f T).
    """
    count = len(drives)
    lines = np.abs(np.fft.fft(drives, axis=0) / count) ** 2
    held = lines * np.sinc(np.arange(count) / count)[:, None] ** 2
    return np.asarray(2.0 * held[1:].sum(axis=0) / lines[1:].sum(axis=0))


PATENT_FIGURE_4_HZ = 1000.0
POINTS_PER_CHIP = 64


@dataclass(frozen=True)
class Waveform:
    """A signal of the patent's FIG. 4: all have the rate of 1 kHz, and the sensor one sample a half-wave or chip.

    Attributes
    ----------
    name : str
    values : ndarray, shape (1023 * 64,)
        The signal over 1.023 s.
    below : float
        Part of the signal's energy, without its mean, below 1 kHz.
    eddy : float
        Error of its own amplitude through a conductor, as `Figures`; a sine is detected synchronously.
    """

    name: str
    values: FloatArray
    below: float
    eddy: float


def figure_4(conductor_s: float) -> list[Waveform]:
    """Return the signals of the patent's FIG. 4 beside a conductor with a time constant: sine, square, code."""
    chips = 1023
    turns = np.arange(chips * POINTS_PER_CHIP) / POINTS_PER_CHIP  # of 1 ms
    chip_s = 1.0 / PATENT_FIGURE_4_HZ
    code = code_matrix(10, PATENT_CODES[:1]).astype(np.float64)
    square = np.tile([1.0, -1.0], chips)[:, None]
    phase = 2.0 * np.pi * PATENT_FIGURE_4_HZ * conductor_s
    answers = (
        ("AC: sine", np.sin(2.0 * np.pi * turns), phase**2 / (1.0 + phase**2)),
        ("pulsed DC: square wave", np.repeat(square, POINTS_PER_CHIP // 2), _own(square, 2.0 * conductor_s / chip_s)),
        ("Gold code", np.repeat(code, POINTS_PER_CHIP), _own(code, conductor_s / chip_s)),
    )
    waves = []
    for name, values, eddy in answers:
        energy = np.abs(np.fft.rfft(values - values.mean())) ** 2
        waves.append(Waveform(name, values, float(energy[:chips].sum() / energy.sum()), eddy))
    return waves


def _own(drive: FloatArray, conductor_chips: float) -> float:
    """Return the part of a drive, shape (N, 1), that a conductor adds to it at the samples."""
    return float((drive * conductor(drive, conductor_chips)).sum() / (drive**2).sum())


@dataclass(frozen=True)
class Rise:
    """Relative errors of the patent's strong beacon through coil rise, for each cure.

    Attributes
    ----------
    tau_chips : float
    ignored, exact, sharp, unknown : float
        No cure; exact templates; sharpened samples; regression on three lags without knowing tau.
    range_m : float
        Error of a range of 2 m if it is ignored: the field falls with the third power.
    """

    tau_chips: float
    ignored: float
    exact: float
    sharp: float
    unknown: float
    range_m: float


PATENT_MG = np.array([12.0, 6.0, 1.0])
PATENT_CODES = (2, 3, 4)
PATENT_OFFSET_MG = 500.0


def patent_example() -> tuple[FloatArray, FloatArray]:
    """Estimate the patent's 12, 6 and 1 mG with 500 mG of earth field: plainly and exactly, shapes (3,)."""
    codes = code_matrix(10, PATENT_CODES).astype(np.float64)
    samples = (codes @ PATENT_MG + PATENT_OFFSET_MG)[:, None] * np.ones(3)
    exact = TemplateAccess("123", codes, [constant(len(codes))], 1.0).from_samples(samples)
    return plain_correlation(samples, 10, PATENT_CODES)[:, 0], exact.field_T[:, 0]


def coil_rise(tau_chips: float) -> Rise:
    """Separate the patent's example with coils that settle slowly, by each cure; errors of the beacon of 12 mG."""
    codes = code_matrix(10, PATENT_CODES).astype(np.float64)
    offset = [constant(len(codes))]
    templates = filtered(codes, tau_chips)
    samples = (templates @ PATENT_MG + PATENT_OFFSET_MG)[:, None] * np.ones(3)
    plain = TemplateAccess("123", codes, offset, 1.0)

    def error(field: FloatArray) -> float:
        return float(field[0, 0] / PATENT_MG[0] - 1.0)

    lags = TemplateAccess([name for name in "123" for _ in range(LAGS)], lagged(codes), offset, 1.0)
    ignored = error(plain.from_samples(samples).field_T)
    return Rise(
        tau_chips=tau_chips,
        ignored=ignored,
        exact=error(TemplateAccess("123", templates, offset, 1.0).from_samples(samples).field_T),
        sharp=error(plain.from_samples(sharpened(samples, tau_chips)).field_T),
        unknown=error(lags.from_samples(samples).field_T.reshape(-1, LAGS, 3).sum(axis=1)),
        range_m=2.0 * ((1.0 + ignored) ** (-1.0 / 3.0) - 1.0),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _dB(ratio: float) -> float:
    return float(20.0 * np.log10(max(ratio, 1e-15)))

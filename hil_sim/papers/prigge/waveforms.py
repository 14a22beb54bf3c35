"""Pictures of waveforms and spectra: the patent's FIG. 1 to 4, drawn from the drives that the comparison uses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from goldfield.types import FloatArray
from hil_sim.papers.plot import panels, save
from hil_sim.papers.prigge.comparison import POINTS_PER_CHIP, Setup, Waveform, code_drives, slot_drives, tone_drives

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEACONS = 3
SHOWN_MS = 20
SPECTRUM_HZ = 4000.0


def draw(path: str, waves: list[Waveform]) -> None:
    """Draw the three ways for three beacons (FIG. 1 to 3) above the waveforms and spectra of FIG. 4.

    Parameters
    ----------
    path : str
        File to write: PNG, PDF or SVG by its ending.
    waves : list of Waveform
        The signals of FIG. 4.

    Raises
    ------
    UserError
        If the file cannot be written.
    SystemFailure
        If matplotlib is not installed.
    """
    setup = Setup(beacons=BEACONS, degree=6)
    ways = (
        ("FIG. 1: AC (FDMA)", tone_drives(setup)),
        ("FIG. 2: pulsed DC (TDMA)", slot_drives(setup)),
        ("FIG. 3: codes (CDMA)", code_drives(setup)),
    )
    figure, axes = panels(3, "Waveforms and spectra", rows=1 + len(waves))
    for place, (title, drives) in enumerate(ways):
        _beacons(axes[place], title, drives)
    for row, wave in enumerate(waves, start=1):
        _wave(axes[3 * row : 3 * row + 3], wave)
    save(figure, path)


def _beacons(axes: Axes, title: str, drives: FloatArray) -> None:
    """Draw the drives of some beacons below each other."""
    chips = np.arange(len(drives) + 1)
    for beacon in range(BEACONS):
        axes.step(chips, 0.4 * np.append(drives[:, beacon], drives[-1, beacon]) - beacon, where="post")
    axes.set(title=title, xlabel="chip", yticks=[0, -1, -2], yticklabels=["beacon 1", "beacon 2", "beacon 3"])


def _wave(axes: list[Axes], wave: Waveform) -> None:
    """Draw the waveform, its spectrum up to 4 kHz, and the spectrum's sum."""
    shown = wave.values[: SHOWN_MS * POINTS_PER_CHIP]
    axes[0].plot(np.arange(len(shown)) / POINTS_PER_CHIP, shown)
    axes[0].set(title=f"FIG. 4: {wave.name}", xlabel="ms", ylim=(-1.3, 1.3))
    energy = np.abs(np.fft.rfft(wave.values - wave.values.mean())) ** 2
    energy /= energy.sum()
    frequency = np.arange(len(energy)) * 1000.0 * POINTS_PER_CHIP / len(wave.values)
    low = frequency <= SPECTRUM_HZ
    axes[1].plot(frequency[low] / 1000.0, np.sqrt(energy[low] / energy.max()))
    axes[1].set(title="amplitude spectrum", xlabel="kHz", ylabel="of the largest line")
    axes[2].plot(frequency[low] / 1000.0, np.cumsum(energy)[low])
    axes[2].axvline(1.0, linestyle=":", color="gray")
    axes[2].set(title=f"energy below ({wave.below:.1%} below 1 kHz)", xlabel="kHz", ylim=(0.0, 1.05))

"""What the beacon's image makes two coils carry, on the emulator: sinusoids in quadrature, levels of several codes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.firmware.apps.test_beacon_app import drives, statuses
from tests.firmware.host_rig import MS, PIN_SYNC_OUT, PINS_BRIDGE, Board, Coil, beacon, chip_seconds, gold_chips

AMPLITUDE_A, GAINS, PPM = 8.0, (0.94, 1.07), 30.0
SYNC_MASTER = {"node": 1, "amplitude": AMPLITUDE_A, "sync_master": 1}


def run(parameters: dict[str, object], until: int) -> Board:
    coils = [Coil(gain=gain) for gain in GAINS]
    board = beacon(*coils, parameters={**SYNC_MASTER, **parameters}, ppm=PPM, emulated=True)
    board.run(until)
    board.close()
    return board


def currents(board: Board, channel: int, chips: int) -> np.ndarray:
    """Return the currents of the last whole cycle, in the middle of each chip, A."""
    edge = board.edges(PIN_SYNC_OUT)[-2]
    middles = np.array([edge + round((t + 0.5) * chip_seconds(PPM) * 1e12) for t in range(chips)])
    return GAINS[channel] * drives(board, middles, channel)


@pytest.fixture(scope="module")
def rotating() -> Board:
    return run({"waveform": 3, "periods": 5, "degree": 11}, 1010 * MS)


def test_sinusoids_in_quadrature(rotating: Board) -> None:
    lines = [2.0 * np.fft.rfft(currents(rotating, channel, 2047)) / 2047 for channel in (0, 1)]
    amplitudes = [abs(line[5]) for line in lines]
    degrees = [np.degrees(np.angle(line[5])) for line in lines]
    others = [np.delete(np.abs(line), 5).max() for line in lines]
    print(f"amplitudes {amplitudes} A, phases {degrees} degrees, largest other line {others} A")
    assert amplitudes == pytest.approx([AMPLITUDE_A] * 2, abs=0.01)
    assert degrees == pytest.approx([0.0, -90.0], abs=0.01)
    assert max(others) < 2e-3  # Half a count of the set-point.
    reports = statuses(rotating)
    assert [reports[c]["current"] for c in (0, 1)] == pytest.approx([AMPLITUDE_A] * 2, abs=0.01)


def test_set_points_change_with_their_bridges(rotating: Board) -> None:
    """Where the current changes sign both move, at a distance that is the same all the time."""
    for channel, pins in enumerate(PINS_BRIDGE):
        bridge = np.unique([time for time, pin, _ in rotating.pins if pin in pins])[2:]
        steps = np.array([time for time, _ in rotating.analog[channel]])
        behind = steps[np.searchsorted(steps, bridge[bridge < steps[-1]])] - bridge[bridge < steps[-1]]
        near = behind[behind < 1e6]
        print(f"channel {channel}: set-point {near.min() / 1e3:.0f} to {near.max() / 1e3:.0f} ns behind the bridge")
        assert len(near) > 0.7 * len(behind)
        assert near.max() < 100e3
        assert np.ptp(near) < 25e3  # A cycle of the DAC's clock.


def test_superposed_codes_give_their_levels() -> None:
    codes = [(10, 700, 3, 1), (5, 7, 30, 33)]
    board = run({"waveform": 4, "codes": [n for code in codes for n in code]}, 610 * MS)
    expected = np.zeros(1023)
    for degree, index, offset, hold in codes:
        own = gold_chips(index, degree)
        expected += [own[(t // hold + offset) % len(own)] / len(codes) for t in range(1023)]
    error = currents(board, 0, 1023) - AMPLITUDE_A * expected
    print(f"largest error {np.abs(error).max() * 1e3:.1f} mA, levels {np.unique(expected)}")
    assert np.abs(error).max() < 0.01
    assert not drives(board, np.array([board.edges(PIN_SYNC_OUT)[-2] + MS]), 1).any()

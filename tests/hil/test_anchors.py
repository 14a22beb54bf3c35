"""Anchors on the whole chain: four boards that drive coils and measure each other, beside a sensor board."""

from collections import Counter

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield.access.epoch import EpochSeparator
from goldfield.link.reports import Assembler
from goldfield_protocol import FrameDecoder, decode
from hil_sim.bench import SimulatedBench

pytestmark = pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too

CYCLES = 15
LEAST_P = 1e-4
SETTLED = 0.99
"""A current of this part of its parameter is none that changes sides at the moment."""


class Recording:
    """What the boards of anchors4 say in some cycles, and their coils' currents."""

    def __init__(self, boards, directory):
        bench = SimulatedBench("anchors4", boards, directory)
        try:
            self.scenario, self.site, rig = bench.scenario, bench.site, bench.rig
            self.numbers = range(len(self.scenario.beacons) + 1)
            decoders = [FrameDecoder() for _ in self.numbers]
            for board in self.numbers:
                list(decoders[board].feed(rig.serial_read(board)))
            rig.can_read()
            before = rig.can_statistics()
            self.serial = [b"" for _ in self.numbers]
            self.seconds = CYCLES * self.site.cycle_s + 0.02
            looks = []
            for _ in range(100):
                rig.advance(self.seconds / 100)
                looks.append([abs(rig.coil_current_A(board)) for board in self.numbers[1:]])
                self.serial = [said + rig.serial_read(board) for board, said in enumerate(self.serial)]
            frames = [frame for board, said in enumerate(self.serial) for frame in decoders[board].feed(said)]
            self.messages = [decode(frame.identifier, frame.data) for frame in frames]
            self.can = [decode(frame.identifier, frame.data) for frame in rig.can_read()]
            self.busy = (rig.can_statistics()["busy_ps"] - before["busy_ps"]) * 1e-12 / self.seconds
        finally:
            bench.rig.close()
        amplitudes = np.array([beacon.circuit.current_A for beacon in self.scenario.beacons])
        settled = np.where(np.array(looks) > SETTLED * amplitudes, looks, np.nan)
        self.amplitude_A = np.nanmean(settled, axis=0)

    def node(self, board):
        return self.scenario.sensor.node if board == 0 else self.scenario.beacons[board - 1].node

    def reports(self, board):
        """The complete cycles that a board reported."""
        assembler = Assembler()
        own = [message for message in self.messages if message.node == self.node(board)]
        return [report for message in own for report in assembler.feed(message, 0.0)]

    def fields(self, board):
        """Cycle by beacon by axis, separated, in the frame of the board's sensor."""
        separator = EpochSeparator(self.site)
        fields = [separator.fields(report) for report in self.reports(board)]
        assert all(f.beacons == ("a1", "a2", "a3", "a4") for f in fields)
        return np.array([f.field_T for f in fields]), fields[0].sigma_T

    def truth(self, board):
        """The same by magpylib."""
        pose = self.scenario.motion_of(board)
        position, rotation = pose.poses(np.array([0.0]))
        result = []
        for beacon, amplitude_A in zip(self.scenario.beacons, self.amplitude_A, strict=True):
            coil = beacon.geometry
            turn, _ = Rotation.align_vectors([coil.axis], [[0.0, 0.0, 1.0]])
            circle = magpylib.current.Circle(
                current=amplitude_A * coil.turns,
                diameter=2.0 * coil.radius_m,
                position=coil.position_m,
                orientation=turn,
            )
            result.append(rotation[0].inv().apply(circle.getB(position[0])))
        return np.array(result)


@pytest.fixture(scope="module")
def recording(rig_kind, tmp_path_factory):
    return Recording(rig_kind, tmp_path_factory.mktemp("anchors4"))


@pytest.mark.parametrize("board", range(5))
def test_fields_of_the_others_are_magpylibs_within_the_noise(recording, board):
    """Chi-square over all cycles, and over their mean, which is four times as strict.

    Board 0 is the sensor, to which all four anchors are others.
    """
    fields, sigma_T = recording.fields(board)
    others = np.arange(4) != board - 1
    errors = ((fields - recording.truth(board)) / sigma_T[:, None])[:, others]
    assert len(fields) >= CYCLES - 1
    for sums, freedom in (
        (np.sum(errors**2), errors.size),
        (len(errors) * np.sum(errors.mean(axis=0) ** 2), errors[0].size),
    ):
        p = chi2.sf(sums, freedom)
        print(f"board {board}: chi-square {sums:.1f} of {freedom}, p {p:.3f}")
        assert LEAST_P < p < 1.0 - LEAST_P


@pytest.mark.parametrize("board", range(1, 5))
def test_own_field_is_that_of_the_mounting(recording, board):
    """Some 18 uT: 0.02 % is a step of the set-point."""
    fields, sigma_T = recording.fields(board)
    own, truth = fields[:, board - 1], recording.truth(board)[board - 1]
    limit = 3e-4 * np.linalg.norm(truth) + 5.0 * np.max(sigma_T) / np.sqrt(len(own))
    assert np.linalg.norm(truth) > 1.7e-5
    assert np.abs(own.mean(axis=0) - truth).max() < limit


def test_every_cycle_of_every_board_on_serial_and_on_can(recording):
    report = ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", "FIELD")
    cycles = []
    for board in recording.numbers:
        own = [message for message in recording.messages if message.node == recording.node(board)]
        reported = [message for message in own if message.name in report]
        heard = [
            message for message in recording.can if message.node == recording.node(board) and message.name in report
        ]
        cycles.append([message.signals["cycle"] for message in own if message.name == "EPOCH"])
        assert CYCLES - 1 <= len(cycles[-1]) <= CYCLES + 1
        assert np.all(np.diff(cycles[-1]) == 1)
        for message in own:
            assert message.name != "COUNTER" or message.index in (
                10,
                13,
            )  # A start on the way; nothing late, nothing lost.
            if message.name == "EPOCH_STATUS":
                assert (message.signals["locked"], message.signals["saturated"]) == (1, 0)
        both = [message for message in reported if message in heard]
        assert len(both) >= len(reported) - 2 * (3 + 4)  # The first and the last cycle may be heard in part.
        counts = Counter(message.name for message in own)
        assert (counts["DRIVE_STATUS"] > 0) == (board > 0)
    assert max(cycle[0] for cycle in cycles) - min(cycle[0] for cycle in cycles) <= 1
    rate = max(map(len, recording.serial)) / recording.seconds
    print(f"CAN {100 * recording.busy:.1f} % busy, serial at most {rate:.0f} bytes/s")
    assert recording.busy < 0.15
    assert rate < 20_000  # The line carries 200,000.

"""A run of the scenario prigge8 that several files look at: boards that boot take longer than what is judged."""

import pytest

from hil_sim.bench import SimulatedBench

CYCLES = 32
WATCHED_S = 1.0


class Recorded:
    """What the boards of prigge8 did in `CYCLES` cycles from a bench's start on; their time stands still now.

    Attributes
    ----------
    bench : SimulatedBench
        Its `stream` and `truth` hold the whole run.
    reports : list of Report
        The cycles that the sensor reported on its serial port.
    can_frames : list of Frame
        What was on the CAN bus, the seconds before the bench's start included.
    pin_changes : list of ndarray
        By beacon, the changes of its pins in the first `WATCHED_S`.
    """

    def __init__(self, boards, directory):
        self.bench = SimulatedBench("prigge8", boards, directory)
        rig = self.bench.rig
        rig.watch_pins()
        self.reports = self.bench.advance(WATCHED_S)
        self.pin_changes = [rig.pin_changes(1 + number) for number in range(len(self.bench.scenario.beacons))]
        rig.watch_pins(False)
        self.reports += self.bench.reports(CYCLES - len(self.reports))
        self.can_frames = rig.can_read()


@pytest.fixture(scope="session")
def recorded(rig_kind, tmp_path_factory):
    """The run, on the boards of ``--goldfield-rig``; `Recorded` tells what is known of it."""
    made = Recorded(rig_kind, tmp_path_factory.mktemp("recorded"))
    yield made
    made.bench.close()

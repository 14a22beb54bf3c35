"""One trial: something goes wrong on a bench at a seeded moment and is mended; each pose is held to the truth."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from goldfield import site as sites
from goldfield.errors import SystemFailure, UserError
from goldfield.sensor import dialogue, session
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Epoch, Sensor
from goldfield.types import Status
from hil_sim.rig import Truth
from hil_sim.scenario import load_scenario, site_toml
from hil_sim.world.roaming import Roaming
from tests.campaign.links import CanLink, SerialLink
from tests.campaign.stage import CYCLE_S, HIGH_M, LOW_M, RATE_RAD_S, SPEED_M_S, Killed, Kind, Stage

FloatArray = NDArray[np.float64]

BOOT_S = 2.5
"""Virtual time in which boards boot, synchronise and ramp up their currents."""
SOUND_S, AFTER_S = 1.5, 6.0
"""How long the bench is watched before the fault and behind it."""
TRANSFER_S = 0.005
"""About so long after the end of a cycle its last message is there."""
LATE_CYCLES = 5
"""A pose whose number is that of a cycle further away from its arrival was numbered anew."""
SNAP_S = 0.025
"""So near to what the edges of the wire tell a cycle is theirs: 8 mm of the way."""
SILENCE_S = 0.35
"""No pose for so long is noticed by whoever waits for the next one, three cycles."""
SURE = (Status.OK, Status.UNVERIFIED)
STEADY = 5
"""So many poses in a row that have nothing to say end the recovery."""


@dataclass
class Outcome:
    """What one trial did.

    Attributes
    ----------
    group, name : str
    seed : int
    poses, expected : int
        Cycles that gave a pose, and how many there were, from the fault on.
    detected_s : float or None
        From the fault to the first pose that is not plainly ok; None: none was.
    by : str
        What that pose said.
    wrong : int
        Poses said to be ok, or unverified, that are off by more than their protection level.
    worst_m : float
        Largest error of a pose that is ok.
    false_before : int
        Poses that were not plainly ok before the fault.
    recovered_s : float or None
        From the end of the fault to the first of `STEADY` plain poses in a row; None: not seen.
    statuses : dict of str to int
        Poses by status, from the fault on.
    error : str
        Sentence with which the host ended, or a board; empty: it did not.
    build : str
        Sources that it was run with (`build_of`); empty: nobody knows.
    """

    group: str
    name: str
    seed: int
    poses: int = 0
    expected: int = 0
    detected_s: float | None = None
    by: str = ""
    wrong: int = 0
    worst_m: float = 0.0
    false_before: int = 0
    recovered_s: float | None = None
    statuses: dict[str, int] = field(default_factory=dict)
    error: str = ""
    build: str = ""


class Trial(Stage):
    """A bench with a host that reads it; `run` plays the fault. Its attributes are those of `Stage`."""

    def __init__(self, kind: Kind, seed: int, boards: str = "host") -> None:
        random = np.random.default_rng([seed, 16])
        self.kind = kind
        self.at_s = BOOT_S + SOUND_S + float(random.uniform(0.0, 0.2))
        self.until_s = self.at_s + kind.lasts_s
        motion = Roaming(seed, LOW_M, HIGH_M, SPEED_M_S, RATE_RAD_S)
        scenario = replace(load_scenario("prigge8", seed), motion=motion)
        if kind.plan is not None:
            scenario = kind.plan(scenario, self.at_s, self.until_s, random)
        super().__init__(scenario, seed, boards, random)
        self.at(self.at_s, kind.begin)
        self.at(self.until_s, kind.end)
        self._seen: list[tuple[float, float, Epoch]] = []
        self._truth: list[Truth] = []

    def run(self) -> Outcome:
        """Play it."""
        outcome = Outcome(self.kind.group, self.kind.name, self.seed)
        try:
            self._play(outcome)
        except (UserError, SystemFailure) as error:
            outcome.error = str(error)
        finally:
            self.rig.close()
        return outcome

    def _play(self, outcome: Outcome) -> None:
        self.rig.advance(BOOT_S)
        self.link = (SerialLink if self.kind.serial else CanLink)(self.rig, self.tick)
        with tempfile.TemporaryDirectory() as name:
            site_file = Path(name) / "site.toml"
            site_file.write_text(site_toml(self.scenario))
            with patch.object(session, "time", self.link), patch.object(dialogue, "time", self.link):
                options = Options(method=Method.EACH, node=self.scenario.sensor.node)
                again = True
                while again:
                    with Sensor(self.link, "rig", sites.load(site_file), options) as sensor:
                        again = self._watch(sensor, outcome)
        self._judge(self._seen, self._truth, outcome)

    def _watch(self, sensor: Sensor, outcome: Outcome) -> bool:
        """Take poses to the end, with the fault in between; return whether a new host is to go on."""
        epochs = sensor.epochs()
        while self.rig.now_s < self.until_s + AFTER_S:
            try:
                epoch = next(epochs)
            except SystemFailure as error:
                outcome.error = str(error)
                break
            except Killed:
                return True
            self._truth += self.rig.truth()
            self._seen.append((self.rig.now_s, self.link.latest_s, epoch))
            self.rig.advance(self.takes_s)
        return False

    def _place(self, epoch: Epoch, came_s: float, truth: list[Truth]) -> FloatArray:
        """Return where the sensor was in the middle of a cycle, whose last message came at a virtual time.

        The number tells which cycle it was, unless a master that came back has numbered the cycles anew, which is
        struck on CAN alone. A cycle of which messages are lost is handed out with the next one.
        """
        known = min(truth, key=lambda one: abs(one.cycle - epoch.pose.epoch))
        middle_s = known.time_s + (epoch.pose.epoch - known.cycle) * CYCLE_S
        arrived_s = came_s - TRANSFER_S - 0.5 * CYCLE_S
        late = not self.kind.serial and abs(middle_s - arrived_s) > LATE_CYCLES * CYCLE_S
        if late or self.kind.by_arrival:
            middle_s = arrived_s
        nearest_s = min((one.time_s for one in truth), key=lambda time_s: abs(time_s - middle_s))
        if abs(nearest_s - middle_s) < SNAP_S:
            middle_s = nearest_s
        return np.asarray(self.scenario.motion.poses(np.array([middle_s]))[0][0])

    def _judge(self, seen: list[tuple[float, float, Epoch]], truth: list[Truth], outcome: Outcome) -> None:
        outcome.expected = round((self.rig.now_s - self.at_s) / CYCLE_S)
        plain_in_a_row, latest_s = 0, self.at_s
        for now_s, came_s, epoch in seen:
            pose = epoch.pose
            said = words(epoch)
            if pose.status in SURE:
                error_m = float(np.linalg.norm(pose.position_m - self._place(epoch, came_s, truth)))
                outcome.wrong += not error_m <= pose.protection_m
                if pose.status is Status.OK:
                    outcome.worst_m = max(outcome.worst_m, error_m)
            if now_s <= self.at_s:
                outcome.false_before += bool(said)
                continue
            outcome.poses += 1
            outcome.statuses[pose.status.value] = outcome.statuses.get(pose.status.value, 0) + 1
            if outcome.detected_s is None and (now_s - latest_s > SILENCE_S or said):
                silent = now_s - latest_s > SILENCE_S
                outcome.detected_s = latest_s + SILENCE_S - self.at_s if silent else now_s - self.at_s
                outcome.by = "silence" if silent else said
            latest_s = now_s
            if now_s > self.until_s and outcome.recovered_s is None:
                plain_in_a_row = 0 if said else plain_in_a_row + 1
                if plain_in_a_row == STEADY:
                    outcome.recovered_s = max(0.0, now_s - self.until_s - (STEADY - 1) * CYCLE_S)


def words(epoch: Epoch) -> str:
    """Return what a pose says beside being right; empty: it is plainly ok."""
    pose = epoch.pose
    if pose.findings:
        return pose.findings[0].kind.value
    if epoch.notes:
        return epoch.notes[0]
    if pose.excluded:
        return "left out"
    return "" if pose.status is Status.OK else pose.status.value

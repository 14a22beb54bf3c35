"""Poses of a moving sensor at a rate, from the blocks that a board sends or computed by the board, and their replay."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.cli.pose_lines import json_record_line
from goldfield.link.recordings import CandumpWriter
from goldfield.sensor import backlog as backlogs
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import receiver as receivers
from goldfield.sensor import session as sessions
from goldfield.sensor.backlog import CAUGHT_UP_S, LIMIT_S
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Epoch, Fix, Sensor
from goldfield.types import Status
from goldfield.view.lines import Line
from goldfield_protocol.messages import decode
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5
ROAMING = """[motion]
kind = "roaming"
low_m = [0.6, 0.6, 0.5]
high_m = [1.5, 1.5, 1.3]
speed_m_per_s = 1.0
rate_rad_per_s = 1.0

"""


class Bench:
    """A moving sensor in virtual time."""

    def __init__(self, directory, link_of):
        text = (ROOT / "hil_sim/scenarios/prigge8.toml").read_text()
        path = directory / "roaming8.toml"
        path.write_text(text[: text.index("[motion]")] + ROAMING + text[text.index("[coil]") :])
        scenario = load_scenario(str(path))
        (directory / "site.toml").write_text(site_toml(scenario))
        self.site = sites.load(directory / "site.toml")
        self.rig = Rig(scenario, "host")
        self.rig.advance(BOOTED_S)
        self.link = link_of(self.rig)
        self.log = directory / "run.log"
        self.truth = {}

    def run(self, options, count):
        """Return so many items of the stream, of a run that is recorded."""
        recorder = CandumpWriter(self.log, force=True)
        with Sensor(self.link, "rig", self.site, options, recorder) as sensor:
            items = list(itertools.islice(sensor.stream(), count))
            counts = sensor.link_counts
        recorder.close()
        self.truth.update({truth.cycle: truth for truth in self.rig.truth()})
        return items, counts

    def errors(self, items, settling_s=0.1):
        """Return how far, m and rad, the poses at a rate are from the truth at their own times."""
        reports = [item.report for item in items if isinstance(item, Epoch)]
        middle = next(one for one in reports if one.cycle in self.truth)
        late_s = middle.time_s - self.truth[middle.cycle].time_s  # of the sensor's clock
        poses = [item.pose for item in items if isinstance(item, Fix)]
        poses = [pose for pose in poses if pose.time_s > poses[0].time_s + settling_s]
        position, rotation = (
            self.rig.scenario.installed.at(0.0).motion_of(0).poses(np.array([pose.time_s - late_s for pose in poses]))
        )
        found = Rotation.from_quat([pose.orientation_xyzw for pose in poses])
        return (
            np.linalg.norm(position - [pose.position_m for pose in poses], axis=1),
            (found * rotation.inv()).magnitude(),
            poses,
        )

    def replayed(self, options):
        with open_sensor("log", str(self.log), self.site, options) as recording:
            return list(recording.stream())


@pytest.fixture
def bench(monkeypatch, tmp_path):
    benches = []

    def make(link_of):
        benches.append(Bench(tmp_path, link_of))
        for module in (sessions, dialogues):
            monkeypatch.setattr(module, "time", benches[0].link)
        return benches[0]

    yield make
    for one in benches:
        one.rig.close()


def over_stated(poses, position, attitude):
    """Return the rms error of position and of attitude, each over what its covariance states."""
    of_position = np.trace([pose.position_cov_m2 for pose in poses], axis1=1, axis2=2)
    of_attitude = np.trace([pose.attitude_cov_rad2 for pose in poses], axis1=1, axis2=2)
    ratios = [float(np.sqrt(np.mean(e**2 / of))) for e, of in ((position, of_position), (attitude, of_attitude))]
    print(f"error over stated: {ratios[0]:.3f} (position), {ratios[1]:.3f} (attitude), {len(poses)} poses")
    return ratios


def lines(items):
    line = json_record_line(truth=False)
    return [line(Line(item.pose, item if isinstance(item, Epoch) else None, 0)) for item in items]


@pytest.mark.parametrize("link_of", [RigLink, RigSerialLink])
def test_blocks_give_poses_at_their_own_time_and_the_recording_the_same(bench, link_of):
    one = bench(link_of)
    options = Options(Method.TRACK, rate_hz=330.0)
    items, counts = one.run(options, 450)
    assert counts == {}
    position, attitude, poses = one.errors(items)
    assert len(poses) > 350
    assert np.sqrt((position**2).mean()) < 0.02
    assert np.sqrt((attitude**2).mean()) < 0.04
    np.testing.assert_allclose(np.diff([pose.time_s for pose in poses]), 31 * 97.75e-6, rtol=5e-3)
    assert {pose.status for pose in poses} == {Status.OK}
    assert over_stated(poses, position, attitude) == pytest.approx([1.0, 1.0], abs=0.3)
    epochs = [item for item in items if isinstance(item, Epoch)]
    assert all(epoch.at_rate for epoch in epochs)
    ends = [epoch.pose.time_s - epoch.report.time_s for epoch in epochs]
    np.testing.assert_allclose(ends, 0.5 * one.site.cycle_s, rtol=1e-3)
    assert lines(one.replayed(options)[: len(items)]) == lines(items)
    later = one.replayed(Options(Method.TRACK, rate_hz=330.0, lag_s=0.05))
    smoothed, _, after = one.errors(later)
    assert len(after) >= len(poses)
    assert np.sqrt((smoothed**2).mean()) < 0.8 * np.sqrt((position**2).mean())
    assert {pose.status for pose in after} == {Status.OK}


def test_without_a_rate_the_pose_of_an_epoch_is_that_of_its_end(bench):
    one = bench(RigLink)
    items, _ = one.run(Options(Method.TRACK), 8)
    assert all(isinstance(item, Epoch) and not item.at_rate for item in items)
    assert [item.pose.epoch for item in items] == [item.report.cycle for item in items]
    assert lines(one.replayed(Options(Method.TRACK))[:8]) == lines(items)
    sent = [decode(message.arbitration_id, bytes(message.data)) for message in _rest(one.link)]
    assert sum(message.name == "EPOCH" for message in sent) > 3
    assert not any(message.name.startswith("BLOCK") for message in sent[200:]), "they end with the run"


def _rest(link, count=500):
    return [message for message in (link.receive(1.0) for _ in range(count)) if message is not None]


def test_lost_messages_cost_a_block_each_and_no_pose_at_another_rate(bench):
    """A tenth of the blocks, and each second header, are lost."""
    one = bench(RigLink)
    options = Options(Method.TRACK, rate_hz=100.0)
    one.run(options, 100)
    kept, headers, blocks = [], 0, 0
    for line in one.log.read_text().splitlines():
        name = _name(line)
        headers += name == "EPOCH"
        blocks += name == "BLOCK"
        if (name == "EPOCH" and headers % 2) or (name == "BLOCK" and blocks % 10 == 0):
            continue
        kept.append(line)
    one.log.write_text("\n".join(kept))
    items = one.replayed(options)
    times = [item.pose.time_s for item in items if isinstance(item, Fix)]
    assert len(times) > 60
    np.testing.assert_allclose(np.diff(times), 0.01, atol=1e-4)
    first, *others = [item.pose.status for item in items if isinstance(item, Fix)]
    assert first in (Status.OK, Status.UNVERIFIED)  # It rests on the start alone, whose protection level is near 0.5 m.
    assert set(others) == {Status.OK}


def _name(line):
    frame = line.split()[2]
    identifier, data = frame.split("#")
    message = None if data == "R" else decode(int(identifier, 16), bytes.fromhex(data))
    return None if message is None else message.name


def test_a_sensor_that_restarts_gives_poses_again_and_its_replay_too(bench):
    one = bench(RigLink)
    options = Options(Method.TRACK, rate_hz=330.0)
    recorder = CandumpWriter(one.log)
    sensor = Sensor(one.link, "rig", one.site, options, recorder)
    stream = sensor.stream()
    before = list(itertools.islice(stream, 60))
    one.rig.power_cycle_sensor(0.3)
    after = list(itertools.islice(stream, 400))
    recorder.close()
    fixes = [item.pose for item in before + after if isinstance(item, Fix)]
    times = np.array([pose.time_s for pose in fixes])
    (jump,) = np.flatnonzero(np.diff(times) < 0.0)
    assert len(times) - jump > 200
    assert "sensor 100 restarted" in fixes[jump + 1].reason
    assert lines(one.replayed(options)[: len(before + after)]) == lines(before + after)


def test_poses_that_the_sensor_computes_are_passed_on_at_a_rate(bench):
    one = bench(RigLink)
    options = Options(Method.ON_SENSOR, rate_hz=110.0)
    items, _ = one.run(options, 170)
    position, attitude, poses = one.errors(items, settling_s=0.3)
    assert len(poses) > 80
    assert np.sqrt((position**2).mean()) < 0.03
    assert np.sqrt((attitude**2).mean()) < 0.06
    np.testing.assert_allclose(np.diff([pose.time_s for pose in poses]), 3 * 31 * 97.75e-6, rtol=5e-3)
    assert lines(one.replayed(options)[: len(items)]) == lines(items)


class Wall:
    """The wall clock of a machine that is late for half a second: what comes meanwhile has waited."""

    WAITED_S = (0.0, 0.9 * LIMIT_S, 0.9 * LIMIT_S, 1.1 * LIMIT_S, 1.1 * CAUGHT_UP_S, 0.0)

    def __init__(self, rig, begin_s):
        self._rig, self._begin_s = rig, begin_s

    def time(self):
        waited_s = np.interp(self._rig.now_s - self._begin_s, [-0.3, -0.2, 0.0, 0.01, 0.49, 0.5], self.WAITED_S)
        return self._rig.now_s + waited_s

    @staticmethod
    def process_time():
        return 0.0


def test_a_run_that_falls_behind_leaves_poses_out_and_says_so_once(bench, monkeypatch, capsys):
    one = bench(RigLink)
    wall = Wall(one.rig, one.rig.now_s + 1.6)
    for module in (backlogs, receivers):
        monkeypatch.setattr(module, "time", wall)
    options = Options(Method.TRACK, rate_hz=330.0)
    items, counts = one.run(options, 550)
    lost, left_out = counts["blocks of chips lost"], counts["messages left out, because this machine fell behind"]
    assert len(counts) == 2
    text = f"this machine is too slow for so many poses: blocks that have waited for more than {LIMIT_S:g} s"
    assert capsys.readouterr().err.count(text) == 1
    position, _, poses = one.errors(items)
    gaps = np.diff([pose.time_s for pose in poses])
    assert gaps.max() == pytest.approx(0.5, abs=0.03)
    assert lost == round(gaps.max() / (31 * 97.75e-6)) - 1
    assert left_out == pytest.approx(9 * lost, abs=20)
    assert (gaps > 0.004).sum() == 1
    assert np.sqrt((position**2).mean()) < 0.02
    assert len([item for item in items if isinstance(item, Epoch)]) > 15, "cycles are told all the same"
    again = [item.pose.time_s for item in one.replayed(options) if isinstance(item, Fix)]
    assert np.diff(again).max() < 0.004, "a recording leaves nothing out"


def test_who_waits_for_its_reader_is_read_to_the_last_block(bench, monkeypatch):
    """A bench behind a pseudo-terminal, on a machine that falls behind."""
    one = bench(RigLink)
    one.link.sender_waits = True
    wall = Wall(one.rig, one.rig.now_s + 1.6)
    for module in (backlogs, receivers):
        monkeypatch.setattr(module, "time", wall)
    items, counts = one.run(Options(Method.TRACK, rate_hz=330.0), 550)
    assert counts == {}
    assert np.diff([item.pose.time_s for item in items if isinstance(item, Fix)]).max() < 0.004


def test_a_bus_that_is_only_listened_to_is_read_block_by_block(bench):
    """Another host has set the sensor, so that blocks are on the bus."""
    one = bench(RigLink)
    other = Sensor(one.link, "rig", one.site, Options(Method.TRACK))
    next(other.stream())
    one.link.listen_only = True
    one.link.send = None
    items, _ = one.run(Options(Method.TRACK, rate_hz=330.0, listen_only=True), 100)
    assert sum(isinstance(item, Fix) for item in items) > 90

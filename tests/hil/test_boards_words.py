"""What the boards of a bench say of themselves, while something is wrong with them: no wrong ``ok``, and how soon.

The host sits on the CAN bus of host boards and talks to them, in virtual time.
"""

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.link.recordings import CandumpWriter
from goldfield.nodes.conversation import CLEAR, board_of
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.opening import open_log
from goldfield.sensor.pipeline import Sensor
from goldfield.types import Status
from goldfield_protocol import encode
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.hil.rig_link import RigLink, altered_boards

POSITION_M = np.array([0.9, 1.2, 0.8])
WRONG_M = 0.05
BOOTED_S = 2.5


@pytest.fixture
def listen(monkeypatch, tmp_path):
    """Return a function that lets a bench boot, some boards of it changed, and listens to its sensor on CAN."""
    rigs = []

    def make(name="prigge8", pages=None, sensor_ppm=None, second_sensor=False, recorder=None):
        scenario = load_scenario(name)
        site_file = tmp_path / "site.toml"
        site_file.write_text(site_toml(scenario))
        rig = Rig(scenario, altered_boards(pages, sensor_ppm))
        others = [(Rig(scenario, "host", seed=7), scenario.sensor.node)] if second_sensor else []
        rigs.extend([rig, *(other for other, _ in others)])
        for each in rigs:
            each.advance(BOOTED_S)
        link = RigLink(rig, others)
        monkeypatch.setattr(sessions, "time", link)
        monkeypatch.setattr(dialogues, "time", link)
        return rig, link, Sensor(link, name, sites.load(site_file), recorder=recorder)

    yield make
    for rig in rigs:
        rig.close()


def poses_of(sensor, count):
    """Poses of the next cycles; none of those that are ok is wrong."""
    epochs = sensor.epochs()
    poses = [next(epochs).pose for _ in range(count)]
    for pose in poses:
        assert pose.status is not Status.OK or np.linalg.norm(pose.position_m - POSITION_M) < WRONG_M, pose
    return poses


def told_after_s(sensor, rig, text, most_cycles):
    """Virtual time until the reason of a pose holds a text; no ok that is wrong comes before."""
    begin_s, epochs = rig.now_s, sensor.epochs()
    for _ in range(most_cycles):
        pose = next(epochs).pose
        assert pose.status is not Status.OK or np.linalg.norm(pose.position_m - POSITION_M) < WRONG_M, pose
        if text in (pose.reason or ""):
            return rig.now_s - begin_s
    raise AssertionError(f"'{text}' was not told in {most_cycles} cycles")


@pytest.mark.parametrize("name", ["prigge8", "prigge8can"])
def test_a_sensor_whose_clock_is_400_ppm_off_is_never_ok(listen, name):
    _, _, sensor = listen(name, sensor_ppm=400.0)
    poses = poses_of(sensor, 20)
    assert {pose.status for pose in poses} <= {Status.INCONSISTENT, Status.FAILED}
    assert all("the clock of sensor 100 is not locked" in pose.reason for pose in poses)


@pytest.mark.parametrize("name", ["prigge8", "prigge8can"])
def test_of_two_masters_one_follows(listen, name):
    """By the time that the bench has booted one leads, whichever began first, and both beacons count."""
    _, _, sensor = listen(name, pages={2: {"sync_master": 1}})
    poses = poses_of(sensor, 20)[-8:]
    assert {pose.status for pose in poses} == {Status.OK}
    assert all("b2" in pose.used for pose in poses)


def test_two_sensors_of_one_number(listen):
    _, _, sensor = listen(second_sensor=True)
    poses = poses_of(sensor, 20)
    assert {pose.status for pose in poses} <= {Status.INCONSISTENT, Status.FAILED}
    assert all("two boards have the number 100" in pose.reason for pose in poses)


@pytest.mark.parametrize(
    ("fault", "text"),
    [("coil_open", "an open coil"), ("sense_shorted", "over-current"), ("driver", "a driver fault")],
)
def test_a_beacon_with_a_fault_is_left_out_and_comes_back(listen, fault, text):
    rig, link, sensor = listen()
    poses_of(sensor, 12)  # by then each beacon's code is known
    rig.fault(2, fault)
    after_s = told_after_s(sensor, rig, f"b2's board (node 2) reports {text}", 4)
    print(f"{fault}: told {after_s:.2f} s after it began")
    assert after_s < 0.25
    poses = poses_of(sensor, 5)
    assert all("b2" in pose.excluded and len(pose.used) == 7 for pose in poses)
    rig.fault(2, fault, False)
    poses_of(sensor, 1)  # The mended measurement, supply or pin has been seen.
    named = {"board": board_of(rig._specs[2].unique_id.hex()), "argument": 0}
    link.send(*encode("COMMAND", named, node=2, index=CLEAR))  # Nothing but this brings it back.
    back = poses_of(sensor, 20)[-1]
    assert (len(back.used), back.reason) == (8, None)


def test_a_board_without_power_is_told(listen):
    rig, _, sensor = listen()
    poses_of(sensor, 12)  # by then each beacon's code is known
    rig.power_cycle(3, 60.0)
    assert abs(rig.coil_current_A(3)) > 1.0
    after_s = told_after_s(sensor, rig, "b3's board (node 3) is silent", 30)
    print(f"no power: told {after_s:.2f} s after it went")
    assert 2.0 < after_s < 2.8
    assert rig.coil_current_A(3) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("amplitude_A", [8.0, 9.0])
def test_the_measured_current_is_the_beacons_current(listen, amplitude_A):
    """A board that is set to another current than the site's, truly driven: the beacon serves all the same."""
    rig, _, sensor = listen(pages={3: {"amplitude": amplitude_A}})
    poses = poses_of(sensor, 20)[-8:]
    assert abs(rig.coil_current_A(3)) == pytest.approx(amplitude_A, rel=0.01)
    for pose in poses:
        assert len(pose.used) == 8
        assert pose.findings[0].factor == pytest.approx(amplitude_A / 10.0, rel=1e-3)
        assert np.linalg.norm(pose.position_m - POSITION_M) < 0.03
    assert np.mean([pose.residual for pose in poses]) < 1.5


@pytest.mark.parametrize("off_s", [12.0, pytest.param(30.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["prigge8", "prigge8can"])
def test_the_master_is_dead_for_longer_than_hold_over(listen, name, off_s):
    rig, _, sensor = listen(name)
    poses_of(sensor, 8)
    begin_s = rig.now_s
    rig.power_cycle(1, off_s)
    held = poses_of(sensor, 90)  # 9 s of hold-over, without b1
    assert all(pose.status is Status.OK and pose.excluded == ("b1",) for pose in held)
    told_after_s(sensor, rig, "the clock of sensor 100 is not locked", 20)
    print(f"master dead: told unlocked {rig.now_s - begin_s:.2f} s after it went")
    assert 10.0 < rig.now_s - begin_s < 10.5
    while rig.now_s < begin_s + off_s + 2.0:
        poses_of(sensor, 1)
    assert [pose.status for pose in poses_of(sensor, 3)] == [Status.OK] * 3


@pytest.mark.parametrize("name", ["prigge8", "prigge8can"])
def test_a_master_that_returns_in_hold_over_is_told_in_the_cycle_that_it_spoils(listen, name):
    """Its coil drives by a new time two cycles before the other boards have given up the old one."""
    rig, _, sensor = listen(name)
    poses_of(sensor, 8)
    rig.power_cycle(1, 3.0)
    poses = poses_of(sensor, 60)
    (jump,) = [i for i in range(1, len(poses)) if poses[i].epoch < poses[i - 1].epoch]
    assert {pose.status for pose in poses[: jump - 2]} == {Status.OK}
    for pose in poses[jump - 2 : jump]:
        assert pose.status is Status.INCONSISTENT
        assert "the clock of sensor 100 is not locked" in pose.reason
    assert poses[-1].status is Status.OK


def test_a_recording_gives_the_same_verdicts(listen, tmp_path):
    rig, _, sensor = listen(recorder=CandumpWriter(tmp_path / "run.log"))
    live = poses_of(sensor, 12)
    rig.fault(2, "coil_open")
    live += poses_of(sensor, 4)
    with open_log(tmp_path / "run.log", site=sensor.site) as recording:
        again = {pose.epoch: pose for pose in recording.poses()}
    for pose in live:
        other = again[pose.epoch]
        assert (pose.status, pose.reason, pose.excluded) == (other.status, other.reason, other.excluded)
    assert "b2" in live[-1].excluded

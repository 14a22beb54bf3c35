"""A beacon is moved, or a sheet of metal brought in, while the boards of a bench run: who names it, and how soon.

The host sits on the CAN bus of host boards, in virtual time.
"""

from dataclasses import replace

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Sensor
from goldfield.types import Explanation, Status
from goldfield_protocol import encode
from goldfield_protocol.parameters import PARAMETERS
from hil_sim.rig import Rig
from hil_sim.scenario import Bring, Move, load_scenario, site_toml
from hil_sim.world.sheet import Sheet
from tests.hil.rig_link import RigLink

EVENT_S = 8.0
STEP_M = np.array([0.012, -0.012, 0.0105])
"""A step of 2 cm."""
WRONG_NEES = 8.0
"""Squared error in standard deviations over its three dimensions: what noise exceeds in no run of this length."""


TWO_WORLDS_S = 0.4


def amplitude_A(rig, node):
    """Return the largest current of a coil at moments over the next chip: one may lie in a change of direction."""
    seen = []
    for _ in range(5):
        rig.advance(20e-6)
        seen.append(abs(rig.coil_current_A(node)))
    return max(seen)


@pytest.fixture
def listen(monkeypatch, tmp_path):
    """Return a function that lets host boards boot, something happen to them at `EVENT_S`, and listens on CAN."""
    rigs = []

    def make(name, *events, method=Method.EACH):
        scenario = replace(load_scenario(name), events=events)
        site_file = tmp_path / "site.toml"
        site_file.write_text(site_toml(scenario))
        rig = Rig(scenario, "host")
        rigs.append(rig)
        rig.advance(2.5)
        link = RigLink(rig)
        monkeypatch.setattr(sessions, "time", link)
        monkeypatch.setattr(dialogues, "time", link)
        options = Options(method=method, node=scenario.sensor.node)
        return rig, link, Sensor(link, name, sites.load(site_file), options)

    yield make
    for rig in rigs:
        rig.close()


def is_wrong(pose, position_m):
    """Tell whether a pose is off by more than it promises: its protection level, or its covariance."""
    error = pose.position_m - position_m
    nees = error @ np.linalg.solve(pose.position_cov_m2, error) / 3
    return np.linalg.norm(error) > pose.protection_m or nees > WRONG_NEES


def poses_until(rig, sensor, until_s):
    """Poses with the virtual times, s after the event, at which they came; none that is ok is wrong."""
    told, epochs = [], sensor.epochs()
    position_m = rig.scenario.motion.position_m
    while rig.now_s < EVENT_S + until_s:
        pose = next(epochs).pose
        assert pose.status is not Status.OK or not is_wrong(pose, position_m), pose
        told.append((rig.now_s - EVENT_S, pose))
    return told


def named(told, beacon):
    """When a beacon was named and left out first, and its finding at the end; nobody else was, and it stays so.

    What anchors tell of the cycle in which it happens comes with the sensor's next one, or the one behind it: until
    then, for `TWO_WORLDS_S`, it may be unknown what is wrong. In the cycle that holds some of both worlds another
    beacon may be named: where metal is brought, with 3 of 12 seeds.
    """
    findings = [[f for f in pose.findings if f.kind is not Explanation.BOARD] for _, pose in told]
    out = [time_s for (time_s, pose), found in zip(told, findings, strict=True) if found and beacon in pose.excluded]
    assert out
    late = [(time_s, f) for (time_s, _), found in zip(told, findings, strict=True) for f in found]
    assert {f.beacons for time_s, f in late if time_s >= max(out[0], TWO_WORLDS_S)} == {(beacon,)}
    others = {time_s for time_s, f in late if f.beacons not in ((beacon,), ()) and f.kind is not Explanation.UNKNOWN}
    assert len(others) <= 1
    since_s = max(out[0], TWO_WORLDS_S)
    assert sum(time_s >= since_s for time_s in out) == sum(time_s >= since_s for time_s, _ in told)
    print(f"{beacon} named after {out[0]:.2f} s: {findings[-1][0].text}")
    return out[0], findings[-1][0]


def test_anchors_name_a_coil_that_was_moved_by_2_cm(listen):
    rig, _, sensor = listen("anchors4", Move(EVENT_S, "a2", STEP_M, sensor_stays=True))
    after_s, finding = named(poses_until(rig, sensor, 4.0), "a2")
    assert 0.0 < after_s < 0.3
    assert finding.kind is Explanation.MOVED
    truth_m = rig.scenario.at(EVENT_S).beacons[1].geometry.position_m
    assert np.linalg.norm(finding.position_m - truth_m) < 5e-3


def test_anchors_name_a_coil_to_which_metal_was_brought(listen):
    sheet = Sheet(np.array([4.0, 0.1, -0.1]), np.array([0.0, 0.0, 1.0]), 0.6)
    rig, _, sensor = listen("anchors4", Bring(EVENT_S, sheet))
    after_s, finding = named(poses_until(rig, sensor, 4.0), "a2")
    assert 0.0 < after_s < 0.3
    assert "metal" in finding.text


def test_anchors_tell_a_board_without_power_from_metal(listen):
    rig, _, sensor = listen("anchors4")
    poses_until(rig, sensor, 0.0)
    rig.power_cycle(2, 60.0)
    told = poses_until(rig, sensor, 2.0)
    _, finding = named(told, "a2")
    assert finding.kind is Explanation.DEAD
    assert sum("metal" in (pose.reason or "") for _, pose in told) < 5


def test_a_current_that_a_board_measures_does_not_cost_its_anchor(listen):
    rig, link, sensor = listen("anchors4")
    poses_until(rig, sensor, 0.0)
    values = {"kind": 2, "value_float": 9.9}
    link.send(*encode("PARAM_SET", values, node=2, index=PARAMETERS["amplitude"].first))
    told = poses_until(rig, sensor, 6.0)
    settled = [pose for time_s, pose in told if time_s > 3.0]
    assert amplitude_A(rig, 2) == pytest.approx(9.9, rel=0.01)
    assert all(pose.excluded == () and len(pose.used) == 4 for pose in settled)


@pytest.mark.parametrize("method", [Method.EACH, pytest.param(Method.TRACK, marks=pytest.mark.slow)])
def test_the_history_of_the_residuals_names_a_beacon_that_was_moved_by_2_cm(listen, method):
    """No anchor senses. A cycle does not show 2 cm at 2 mG: the field of b5 changes by four sigma of a cycle."""
    rig, _, sensor = listen("prigge8", Move(EVENT_S, "b5", STEP_M), method=method)
    after_s, finding = named(poses_until(rig, sensor, 14.0), "b5")
    assert 0.0 < after_s < 10.0
    assert finding.kind is Explanation.MOVED
    truth_m = rig.scenario.at(EVENT_S).beacons[4].geometry.position_m
    assert np.linalg.norm(finding.position_m - truth_m) < 0.01


@pytest.mark.parametrize("method", [Method.EACH, Method.TRACK])
def test_the_history_of_the_residuals_names_a_beacon_to_which_metal_was_brought(listen, method):
    sheet = Sheet(np.array([0.0, 0.0, 1.4]), np.array([0.0, 0.0, 1.0]), 0.6)
    rig, _, sensor = listen("prigge8", Bring(EVENT_S, sheet), method=method)
    after_s, _ = named(poses_until(rig, sensor, 4.0), "b5")
    assert 0.0 < after_s < 2.0


@pytest.mark.parametrize("name", ["prigge8", "anchors4"])
def test_sound_boards_name_nobody(listen, name):
    rig, _, sensor = listen(name)
    assert not any(pose.findings or pose.excluded for _, pose in poses_until(rig, sensor, 4.0))

"""A sensor in motion of which nothing but whole cycles comes: a track of them is better than each by itself."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.access.epoch import EpochSeparator
from goldfield.access.sweep import SweepRepair
from goldfield.locate import locate
from goldfield.track import Tracker
from goldfield_protocol import FrameDecoder, decode
from hil_sim.bench import SimulatedBench
from hil_sim.clib import ROOT
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, cycle_bound, straight

pytestmark = pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too

NOISE_T = 2e-7
CYCLES = 80
SETTLING = 5
RATE_RAD_S = np.array([0.6, 0.0, 0.8])
RADIUS_M = 0.5
SPEED_M_S = 1.0


def circle(time_s):
    """Positions, m, shape (t, 3), and velocities on a level circle inside the cube."""
    angle = np.asarray(time_s)[:, None] * SPEED_M_S / RADIUS_M
    ahead = np.hstack([np.cos(angle), np.sin(angle), 0.0 * angle])
    aside = np.hstack([-np.sin(angle), np.cos(angle), 0.0 * angle])
    return np.array([1.0, 1.1, 0.8]) + RADIUS_M * ahead, SPEED_M_S * aside


def waypoints():
    """Return a flight at 1 m/s along the circle, turning at 1 rad/s about a fixed axis."""
    times = np.arange(0.0, 12.0, 0.01)
    turns = Rotation.from_rotvec(np.outer(times, RATE_RAD_S)) * Rotation.from_rotvec([0.3, -0.2, 1.1])
    return times, circle(times)[0], turns.as_rotvec()


@pytest.fixture(scope="module")
def flight(tmp_path_factory, rig_kind):
    """Return the bench of a sensor, and its reports."""
    text = (ROOT / "hil_sim/scenarios/prigge8.toml").read_text()
    start, end = text.index("[motion]"), text.index("[coil]")
    times, positions, turns = waypoints()
    motion = f'[motion]\nkind = "waypoints"\ntimes_s = {times.tolist()}\npositions_m = {positions.tolist()}\n'
    motion += f"rotation_vectors_rad = {turns.tolist()}\n\n"
    directory = tmp_path_factory.mktemp("moving")
    path = directory / "moving8.toml"
    path.write_text(text[:start] + motion + text[end:])
    bench = SimulatedBench(str(path), rig_kind, directory)
    bench.reports(5)
    yield bench, bench.reports(CYCLES)
    bench.rig.close()


@pytest.fixture(scope="module")
def poses(flight):
    """Return two poses of each cycle: of its fields by themselves, and tracked with the sweep taken out."""
    bench, reports = flight
    separator, sweep, tracker = EpochSeparator(bench.site), SweepRepair(bench.site), Tracker(bench.site)
    result = []
    for report in reports:
        fields = separator.fields(report)
        repaired = sweep.repaired(fields, report.offset_T)
        result.append((locate(bench.site, fields), tracker.update(repaired)))
    return result


def bounds_m(truth, epochs):
    """Bound of the position, m, by epoch, from the samples of that cycle alone."""
    room, bounds = Room(prigge_cube(NOISE_T)), {}
    for epoch in epochs:
        true = truth[epoch]
        turn = Rotation.from_quat(true.orientation_xyzw)
        flight = straight(true.position_m, turn, circle([true.time_s])[1][0], RATE_RAD_S)
        bounds[epoch] = cycle_bound(room, flight, NOISE_T)
    return bounds


def over_bound(truth, bounds, poses):
    """Root of the mean square of the position errors, m, and of the same over the bound of one cycle's samples."""
    errors = [np.linalg.norm(pose.position_m - truth[pose.epoch].position_m) for pose in poses]
    ratios = [error / bounds[pose.epoch] for error, pose in zip(errors, poses, strict=True)]
    return np.sqrt(np.mean(np.square(errors))), np.sqrt(np.mean(np.square(ratios)))


def test_the_sensors_own_poses_go_on_and_nothing_is_lost(flight):
    bench, reports = flight
    decoded = [decode(frame.identifier, frame.data) for frame in FrameDecoder().feed(bytes(bench.stream))]
    messages = [message for message in decoded if message is not None]
    own = [m.signals for m in messages if m.name == "POSE_QUALITY"][-CYCLES:]
    cycles = [int(signals["cycle_low"]) for signals in own]
    assert (reports[-1].cycle - cycles[-1]) % 16 <= 1  # That of the last report may be on its way.
    assert (np.diff(cycles) % 16 == 1).all()
    assert all(signals["status"] != 4 for signals in own)  # failed
    counters = {m.index: m.signals["value"] for m in messages if m.name == "COUNTER"}
    assert counters.get(13, 0) <= 1  # the cycle that the first synchronisation cut short
    assert 4 not in counters


def test_a_track_is_better_than_each_cycle_by_itself(flight, poses):
    truth, judged = flight[0].truth(), poses[SETTLING:]
    bounds, figures = bounds_m(truth, [of_cycle[0].epoch for of_cycle in judged]), {}
    for kind, name in enumerate(("alone", "tracked")):
        error, ratio = over_bound(truth, bounds, [of_cycle[kind] for of_cycle in judged])
        figures[name] = ratio
        print(f"{name}: rms {1e3 * error:.2f} mm, {ratio:.3f} times the bound of one cycle's samples")
    # Three components each, and two successive errors of a track are much the same one: 7 % of the root.
    chance = 0.5 * np.sqrt(2.0 / (3 * len(judged) / 2))
    assert figures["tracked"] < 1.0 + 2.0 * chance
    assert figures["tracked"] < 0.7 * figures["alone"]

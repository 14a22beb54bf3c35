"""The sync wire is cut for 10 s and for 60 s while the crystals drift: edges, the lock, and poses before and after.

Emulated boards, since only they have crystals that drift: 2 ppm/K at 0.1 K/s, or 0.1 ppm/s, each board otherwise.

    pytest -m slow -s tests/hil/test_sync_lost.py     prints the errors by the second
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.access.epoch import EpochSeparator
from goldfield.locate import locate
from hil_sim.bench import SimulatedBench
from tests.hil.can_timing import beacon_phases
from tests.hil.reference_coil import COIL

BEFORE, AFTER = 10, 10
"""Cycles that are located before the cut, and when all boards follow the wire again."""
LOCKED_US = 0.5
"""The largest error of an edge of a beacon that drives its coil, which it does while it is locked."""
HOLD_S = (1.0, 10.0)
"""Least and greatest time for which the boards hold over."""
BACK_S = 2.0
"""Time after the wire is whole again within which the sensor is locked, with the beacons in step."""

SCENARIO = """
name = "sync lost"
seed = 12
[ambient]
earth_T = [2e-5, 0.0, -4.5e-5]
[sensor]
node = 100
noise_T = 2e-7
range_T = 2e-4
crystal_ppm = 12.0
{sensor}
[motion]
kind = "still"
position_m = [0.9, 0.8, 0.7]
rotation_vector_rad = [0.3, -0.2, 0.5]
{coil}[[beacon]]
id = "b1"
node = 1
code = 2
position_m = [0.0, 0.0, 0.0]
sync_master = true
crystal_ppm = -20.0
[[beacon]]
id = "b2"
node = 2
code = 3
position_m = [2.0, 0.0, 0.0]
crystal_ppm = 25.0
{second}
[[beacon]]
id = "b3"
node = 3
code = 4
position_m = [0.0, 2.0, 0.3]
crystal_ppm = -5.0
{third}
"""
DRIFTS = {
    "0.1 ppm/s": [f"crystal_ppm_per_s = {rate}" for rate in (0.1, -0.1, 0.05)],
    "2 ppm/K, 0.1 K/s": [f"crystal_ppm_per_K = {k}\ntemperature_K_per_s = 0.1" for k in (2.0, -2.0, 1.0)],
}


def pose_errors(bench, reports):
    """Return the errors of the poses of some reports, m and degrees."""
    separator, truth = EpochSeparator(bench.site), bench.truth()
    position, attitude = [], []
    for report in reports:
        pose = locate(bench.site, separator.fields(report))
        true = truth[pose.epoch]
        turn = Rotation.from_quat(pose.orientation_xyzw) * Rotation.from_quat(true.orientation_xyzw).inv()
        position.append(np.linalg.norm(pose.position_m - true.position_m))
        attitude.append(np.degrees(turn.magnitude()))
    return np.array(position), np.array(attitude)


def second(bench):
    """Run a second; return the reports, and the largest error of the beacons' edges against the master's, us.

    Without edges, since no beacon but the master drives its coil, the error is not a number. The first and the last
    edge of each beacon are left out: where the drive begins or ends, they are those of the enable.
    """
    bench.rig.watch_pins()
    reports = bench.advance(1.0)
    edges = np.concatenate([phases[1:-1] for phases in beacon_phases(bench)])
    return reports, 1e6 * np.abs(edges).max() if len(edges) else np.nan


@pytest.mark.slow
@pytest.mark.parametrize("drift", DRIFTS)
@pytest.mark.parametrize("lost_s", [10, 60])
def test_a_lost_wire_ends_the_lock_in_time_and_poses_come_back(tmp_path, lost_s, drift):
    path = tmp_path / "lost.toml"
    path.write_text(SCENARIO.format(coil=COIL, **dict(zip(("sensor", "second", "third"), DRIFTS[drift], strict=True))))
    bench = SimulatedBench(str(path), "emulated", tmp_path)
    rig = bench.rig
    try:
        bench.advance(8.0)  # The boards learn their drift.
        before = bench.reports(BEFORE)
        assert all(report.locked for report in before)
        for board in range(4):
            rig.fault(board, "sync_wire_cut")
        cut_s, ended_s, edges = rig.now_s, None, []
        for number in range(lost_s):
            reports, edge_us = second(bench)
            edges.append(edge_us)
            told = [bool(report.locked) for report in reports]
            if ended_s is None and False in told:
                ended_s = number + told.index(False) * 0.1
            assert np.isnan(edge_us) or edge_us < LOCKED_US
            if ended_s is not None and number > ended_s + 1.0:
                assert not any(told)  # It does not come back by itself.
        for board in range(4):
            rig.fault(board, "sync_wire_cut", False)
        bench.advance(BACK_S)
        after = bench.reports(AFTER)
        assert all(report.locked for report in after)
        _, edge_us = second(bench)
        assert edge_us < LOCKED_US
        assert np.isnan(edges[-1])
        (here, turned), (back, turned_back) = pose_errors(bench, before), pose_errors(bench, after)
        shown = " ".join(f"{edge:.2f}" for edge in edges if not np.isnan(edge))
        print(
            f"\n{drift}, wire lost for {lost_s} s at {cut_s:.1f} s: sensor locked for {ended_s:.1f} s; edges of "
            f"beacons at most {shown} us by the second, then off; with the wire {edge_us:.2f}; position "
            f"{1e3 * here.mean():.1f} mm before, {1e3 * back.mean():.1f} after, attitude {turned.mean():.2f} and "
            f"{turned_back.mean():.2f} deg"
        )
        assert ended_s is not None
        assert HOLD_S[0] <= ended_s <= HOLD_S[1]
        assert back.mean() < 2.0 * here.mean()
        assert turned_back.mean() < 2.0 * turned.mean()
    finally:
        bench.close()

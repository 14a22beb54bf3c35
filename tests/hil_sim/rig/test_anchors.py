"""Beacons with a sensor of their own: what each sees of the others, of itself and of nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield_protocol.parameters import parse_page
from hil_sim import scenario
from hil_sim.rig import Rig
from hil_sim.world import path
from tests.hil_sim.rig.fakes import FakeBoards, small, write_scenario

QUANTUM_PS = 20 * 10**6
BRIDGE_1 = 29
FULL_A, TAU_S = 120.0 / 0.15, 1.9e-4 / 0.15
QUIET = "0.0\nconverter_noise_LSB = 0.0"
PLACES = {1: [0.4, 0.1, 0.2], 2: [1.0, 0.0, 0.7], 3: [0.2, 1.3, -0.1]}
TURNS = {1: [0.0, 0.0, 0.0], 2: [0.3, 0.1, -0.4], 3: [0.0, 1.0, 0.0]}
MOVING = '"line"\nvelocity_m_per_s = [0.5, 0.2, 0.1]\nrate_rad_per_s = [0.0, 1.0, 0.5]'


def anchored(directory, keys="", **replacements):
    """The small scenario with a sensor on every beacon."""
    file = write_scenario(directory, **replacements)
    head, *beacons = file.read_text().split("[[beacon]]")
    for board, beacon in enumerate(beacons, start=1):
        sensor = f"[beacon.sensor]\nposition_m = {PLACES[board]}\nrotation_vector_rad = {TURNS[board]}\n{keys}\n"
        head += f"[[beacon]]{beacon}\n{sensor}"
    file.write_text(head)
    return scenario.load(file)


def run(scene, seconds, threads=None, slices=1):
    """The samples of all boards and the changes of the beacons' bridges."""
    boards = FakeBoards()
    with Rig(scene, boards, threads=threads) as rig:
        rig.watch_pins()
        for _ in range(slices):
            rig.advance(seconds / slices)
        changes = [rig.pin_changes(board) for board in (1, 2, 3)]
        samples = [boards.samples(board) for board in range(4)]
        rig.close()
    return samples, [change[change["pin"] == BRIDGE_1] for change in changes]


def known_until(times_ps, looker, other, master=1):
    """Up to when a looker knows another's driver (lockstep.h): the start of its step, from its lead and the other's."""
    if looker == other:
        return times_ps + 1
    lead, others_lead = (2 if board == master else 1 for board in (looker, other))
    return (times_ps // QUANTUM_PS - lead + others_lead) * QUANTUM_PS


def test_an_anchor_sees_each_current_as_far_as_it_can_be_known(tmp_path):
    scene = anchored(tmp_path, noise_T=QUIET, bandwidth_Hz="0.0", kind=MOVING)
    samples, bridges = run(scene, 0.3)
    late = 0
    for looker in (1, 2, 3):
        times_ps = samples[looker]["time_ps"]
        coils = [coil for beacon in scene.beacons for coil in beacon.coils]
        columns = path.columns(coils, scene.motion_of(looker), np.zeros(1))[0]
        expected = np.tile(Rotation.from_rotvec(TURNS[looker]).inv().apply([2e-5, 0.0, -4.5e-5]), (len(times_ps), 1))
        started = np.ones(len(times_ps), bool)
        for index, bridge in enumerate(bridges):
            known = np.minimum(known_until(times_ps, looker, index + 1), times_ps + 1)
            at = np.searchsorted(bridge["time_ps"], known, side="left") - 1
            late += np.sum(at != np.searchsorted(bridge["time_ps"], times_ps, side="right") - 1)
            started &= at >= 1
            age_s = (times_ps - bridge["time_ps"][at]) * 1e-12
            sign = np.where(bridge["level"][at], 1.0, -1.0)
            swing_A = sign * (FULL_A - (FULL_A + 10.0) * np.exp(-age_s / TAU_S))
            current_A = np.where(sign * swing_A < 10.0, swing_A, sign * 10.0)
            expected += current_A[:, None] * columns[3 * index : 3 * index + 3]
        got = (samples[looker]["volts"] / 1.65 - 1.0) * 2e-4
        assert started.sum() > 20000
        np.testing.assert_allclose(got[started], expected[started], atol=1e-12)
    assert late > 1000  # the boards' chips are free of each other, so some samples fall just behind a change


def test_an_anchor_above_its_own_coil(tmp_path):
    scene = anchored(tmp_path, noise_T=QUIET, earth_T="[0.0, 0.0, 0.0]")
    with Rig(scene, FakeBoards(still=True)) as rig:
        rig.advance(0.02)
        rig.fault(1, "driver")
        rig.fault(3, "driver")
        rig.advance(0.01)
        field = rig.sensor_field_T(2)
    # Beacon 2 stands at (1, 0, 0) and points up; its sensor is 0.7 m above: Jackson, 5.5.
    axial = 1.25663706127e-6 * 19.0 * 10.0 * 0.149**2 / (2.0 * (0.149**2 + 0.7**2) ** 1.5)
    np.testing.assert_allclose(Rotation.from_rotvec(TURNS[2]).apply(field), [0.0, 0.0, axial], rtol=1e-9, atol=1e-15)


def test_anchors_change_nothing_for_the_sensor_and_have_noise_of_their_own(tmp_path):
    noisy = {"noise_T": "1e-7", "kind": MOVING}
    without, _ = run(small(tmp_path, **noisy), 0.2)
    samples, _ = run(anchored(tmp_path, **noisy), 0.2)
    assert samples[0].tobytes() == without[0].tobytes()
    quiet, _ = run(anchored(tmp_path, noise_T=QUIET, kind=MOVING), 0.2)
    noises = [(a["volts"] - b["volts"])[: 8 * 1500 : 8].ravel() for a, b in zip(samples, quiet, strict=True)]
    for noise in noises:
        assert noise.std() == pytest.approx(np.hypot(1e-7 / 2e-4 * 1.65, 0.5 * 3.3 / 4096), rel=0.05)
    correlation = np.corrcoef(noises) - np.eye(4)
    assert np.abs(correlation).max() < 5.0 / np.sqrt(len(noises[0]))


@pytest.mark.parametrize(("threads", "slices"), [(1, 1), (3, 1), (2, 50)])
def test_the_result_does_not_depend_on_threads_or_slices(tmp_path, threads, slices):
    scene = anchored(tmp_path, kind=MOVING)
    reference, _ = run(scene, 0.2, threads=2)
    samples, _ = run(scene, 0.2, threads=threads, slices=slices)
    assert [one.tobytes() for one in samples] == [one.tobytes() for one in reference]


def test_the_truth_of_each(tmp_path):
    with Rig(anchored(tmp_path, kind=MOVING), FakeBoards()) as rig:
        rig.advance(0.1)
        moving, anchor = rig.truth(), rig.truth(2)
        assert len(moving) == len(anchor) > 20
        assert [line.time_s for line in anchor] == [line.time_s for line in moving]
        assert all(line.position_m.tolist() == PLACES[2] for line in anchor)
        turned = Rotation.from_quat(anchor[0].orientation_xyzw) * Rotation.from_rotvec(TURNS[2]).inv()
        assert turned.magnitude() < 1e-7
        assert not np.array_equal(moving[0].position_m, moving[-1].position_m)
        assert rig.truth(2) == []


def test_an_anchors_front_end_is_the_sensors_unless_it_says_otherwise(tmp_path):
    errors = "2e-4\ngain_error = [0.01, -0.02, 0.015]\noffset_T = [3e-6, -2e-6, 1e-6]"
    scene = anchored(tmp_path, keys="offset_T = [1e-6, 0.0, 0.0]\nrange_T = 1e-3", range_T=errors)
    anchor = scene.beacons[1].sensor
    assert anchor.gain_error.tolist() == [0.01, -0.02, 0.015]
    assert (anchor.offset_T.tolist(), anchor.range_T, anchor.noise_T) == ([1e-6, 0.0, 0.0], 1e-3, 1e-7)
    page = parse_page(scenario.parameter_page(scene, 2))
    assert (page["node"], page["code"], page["code_list"]) == (2, 3, [2, 3, 4])
    assert page["zero_x"] == pytest.approx(2048 + 1e-6 * 2048 / 1e-3)
    assert np.array(page["calibration"]).reshape(3, 3)[1, 1] == pytest.approx(1e-3 / 2048 / 0.98)
    assert "zero_x" not in parse_page(scenario.parameter_page(small(tmp_path), 2))


def test_what_is_wrong_with_an_anchor_is_said(tmp_path):
    with pytest.raises(UserError, match=r"\[\[beacon\]\] 1: sensor: bandwidth_Hz is no known key"):
        anchored(tmp_path, keys="bandwidth_Hz = 1e4")
    with Rig(small(tmp_path), FakeBoards()) as rig, pytest.raises(UserError, match="beacon b has no sensor: give it"):
        rig.sensor_field_T(2)
    inside = anchored(tmp_path, power_on_spread_s="0.0")
    object.__setattr__(inside.beacons[1].sensor, "position_m", np.array([1.149, 0.0, 0.0]))
    with pytest.raises(UserError, match="scenario small: beacon b: the sensor runs through a coil's wire"):
        Rig(inside, FakeBoards())

"""The rig in lock-step, on fake boards: determinism, causality, links, faults, truth."""

from __future__ import annotations

import hashlib
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.errors import SystemFailure, UserError
from hil_sim import scenario as scenarios
from hil_sim.rig import Rig
from hil_sim.world import path
from hil_sim.world.metal import BesideMetal, Metal
from tests.hil_sim.rig.fakes import FakeBoards, small, write_scenario

LINE = '"line"\nvelocity_m_per_s = [0.5, 0.2, 0.1]\nrate_rad_per_s = [0.0, 1.0, 0.5]'
MOVING = {
    "kind": LINE,
    "earth_T": "[2e-5, 0.0, -4.5e-5]\nmains = { frequency_Hz = 50.0, amplitude_T = [1e-8, 0.0, 0.0] }\n"
    "impulses = { rate_Hz = 300.0, amplitude_T = 1e-6 }",
}
BRIDGE_1, SYNC_OUT, ENABLE = 29, 7, 31
BYTE_PS = 5 * 10**6
CAN_BIT_PS = 10**6


def heard(data, kind):
    """The pairs (value, time) that a fake board has written as <kind value time>."""
    base = 16 if kind in ("byte", "frame") else 10
    found = re.findall(rf"<{kind} ([0-9a-f]+) ([0-9]+)>".encode(), data)
    return [(int(value, base), int(time_ps)) for value, time_ps in found]


def record(scenario, ends_s, seed=None, threads=None):
    """Everything that comes out of a run that is cut at the given times."""
    boards = FakeBoards()
    with Rig(scenario, boards, seed, threads=threads) as rig:
        rig.watch_pins()
        serial = [b""] * 4
        for end_s in ends_s:
            rig.run_until(round(end_s * 1e12))
            serial = [old + rig.serial_read(board) for board, old in enumerate(serial)]
        return {
            "serial": serial,
            "samples": [boards.samples(board).tobytes() for board in range(4)],
            "pins": [rig.pin_changes(board).tolist() for board in range(4)],
            "can": rig.can_read(),
            "truth": [line.as_dict() for line in rig.truth()],
            "field": rig.sensor_field_T().tolist(),
        }


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    return small(tmp_path_factory.mktemp("moving"), **MOVING)


@pytest.fixture(scope="module")
def reference(moving):
    return record(moving, [1.2])


@pytest.mark.parametrize(
    "ends",
    [np.arange(1, 121) * 0.01, np.arange(1, 1201) * 0.001, [0.00037, 0.90001, 0.900029, 1.0, 1.000001, 1.19999, 1.2]],
    ids=["10 ms", "1 ms", "odd"],
)
def test_the_result_does_not_depend_on_slices(moving, reference, ends):
    assert record(moving, ends) == reference


@pytest.mark.parametrize(("quiet", "digest"), [(True, "c0022c087c233a52"), (False, "fd3f04e54e8d90dc")])
def test_the_result_does_not_depend_on_what_the_rig_learns(tmp_path, quiet, digest):
    # What the sensor's converters gave before boards had two coils or sensors of their own; counts, as the last bits of
    # a volt are the mathematical library's. With noise, since that comes of the Ziggurat.
    changes = {"noise_T": "0.0\nconverter_noise_LSB = 0.0", "supply_V": "120.0\nsense_noise_A = 0.0"} if quiet else {}
    boards = FakeBoards()
    with Rig(small(tmp_path, **MOVING, **changes), boards) as rig:
        rig.advance(1.2)
        counts = np.floor(boards.samples(0)["volts"] / 3.3 * 4096).astype("<i2")
    assert counts.shape == (98144, 3)
    assert hashlib.sha256(counts.tobytes()).hexdigest()[:16] == digest


@pytest.mark.parametrize("threads", [1, 3])
def test_the_result_does_not_depend_on_threads(moving, reference, threads):
    assert record(moving, [1.2], threads=threads) == reference


def test_the_seed_matters_and_nothing_else(moving, reference):
    assert record(moving, [1.2], seed=7) == reference
    other = record(moving, [1.2], seed=8)
    assert all(a != b for a, b in zip(other["samples"], reference["samples"], strict=True))


def test_the_sensor_samples_the_sum_of_its_parts(tmp_path):
    boards = FakeBoards()
    scenario = small(tmp_path, noise_T="0.0\nconverter_noise_LSB = 0.0", bandwidth_Hz="0.0", kind=LINE)
    with Rig(scenario, boards) as rig:
        rig.watch_pins()
        rig.advance(0.5)
        samples = boards.samples(0)
        bridges = [changes[changes["pin"] == BRIDGE_1] for changes in map(rig.pin_changes, (1, 2, 3))]
        rig.close()
    times_ps = samples["time_ps"]
    columns = path.columns([b.geometry for b in scenario.beacons], scenario.motion, times_ps * 1e-12)
    expected = np.einsum("nij,j->ni", columns[:, 9:18].reshape(-1, 3, 3), scenario.ambient.earth_T)
    settled = np.ones(len(times_ps), dtype=bool)
    for index, bridge in enumerate(bridges):
        at = np.searchsorted(bridge["time_ps"], times_ps, side="right") - 1
        # A swing of 20 A takes L/R ln((V/R + 10)/(V/R - 10)) = 31.7 us; what happens in it is the coil's own test.
        settled &= (at >= 0) & (times_ps - bridge["time_ps"][at] > 32 * 10**6)
        expected += np.where(bridge["level"][at], 10.0, -10.0)[:, None] * columns[:, 3 * index : 3 * index + 3]
    assert settled.sum() > 0.2 * len(times_ps)
    got = (samples["volts"] / 1.65 - 1.0) * 2e-4
    # The columns are cubics good to 1e-5 of a coil's field, which is at most 0.5 uT here.
    np.testing.assert_allclose(got[settled], expected[settled], atol=1e-11)


def test_swings_are_seen_as_they_happen(tmp_path):
    # The sensor's samples inside a swing show the slope V/L: no beacon's change is seen late or early by a quantum.
    boards = FakeBoards()
    scenario = small(tmp_path, noise_T="0.0\nconverter_noise_LSB = 0.0", bandwidth_Hz="0.0", earth_T="[0.0, 0.0, 0.0]")
    with Rig(scenario, boards) as rig:
        rig.watch_pins()
        rig.advance(0.5)
        samples = boards.samples(0)
        bridges = [changes[changes["pin"] == BRIDGE_1] for changes in map(rig.pin_changes, (1, 2, 3))]
        rig.close()
    columns = path.columns([b.geometry for b in scenario.beacons], scenario.motion, np.zeros(1))[0, :9].reshape(3, 3)
    got = (samples["volts"] / 1.65 - 1.0) * 2e-4
    currents = np.linalg.solve(columns.T, got.T).T  # three beacons, three axes: each current follows from the field
    full, tau = 120.0 / 0.15, 1.9e-4 / 0.15
    seen = 0
    for index, bridge in enumerate(bridges):
        at = np.searchsorted(bridge["time_ps"], samples["time_ps"], side="right") - 1
        age = (samples["time_ps"] - bridge["time_ps"][at]) * 1e-12
        swinging = (at >= 1) & (age < 30e-6)
        sign = np.where(bridge["level"][at], 1.0, -1.0)
        slope = sign * full + (-sign * 10.0 - sign * full) * np.exp(-age / tau)
        np.testing.assert_allclose(currents[swinging, index], slope[swinging], atol=1e-6)
        seen += swinging.sum()
    assert seen > 1000


def test_the_own_coil_current_is_sensed_at_chip_ends(tmp_path):
    boards = FakeBoards(still=True)
    with Rig(small(tmp_path, supply_V="120.0\nsense_noise_A = 0.0\nsense_gain_error = 0.02"), boards) as rig:
        rig.advance(0.02)
        volts = boards.samples(2)["volts"][:, 0]
        np.testing.assert_allclose(volts[1:], 1.65 + 10.0 * 0.103125 * 1.02, rtol=1e-12)
        assert rig.coil_current_A(2) == pytest.approx(10.0)
        rig.close()


def test_sync_edges_reach_every_other_board_at_their_time(tmp_path):
    with Rig(small(tmp_path), FakeBoards()) as rig:
        rig.watch_pins()
        rig.advance(0.05)
        changes = rig.pin_changes(1)
        edges = [(bool(c["level"]), int(c["time_ps"])) for c in changes[changes["pin"] == SYNC_OUT]]
        past = [edge for edge in edges if edge[1] < 50 * 10**9]
        assert len(past) > 20
        for board in (0, 2, 3):
            assert heard(rig.serial_read(board), "sync")[: len(past)] == past
        assert heard(rig.serial_read(1), "sync") == []
        rising = [time_ps for level, time_ps in past if level]
        np.testing.assert_allclose(rig.sync_edges_s(), np.array(rising) * 1e-12, rtol=0, atol=1e-15)


def test_boards_that_have_power_from_the_first_moment_on_miss_nothing(tmp_path):
    # The fake boards abort if the rig reaches into their past.
    with Rig(small(tmp_path, power_on_spread_s="0.0"), FakeBoards()) as rig:
        rig.advance(0.02)
        assert rig.sync_edges_s()[0] == pytest.approx(1e-6)
        for board in (0, 2, 3):
            assert heard(rig.serial_read(board), "sync")[0] == (1, 10**6)
        assert all(frame.time_s > 5e-4 for frame in rig.can_read())


def test_frames_reach_every_other_board_one_bit_before_their_end_and_their_sender_at_it(tmp_path):
    with Rig(small(tmp_path), FakeBoards()) as rig:
        rig.advance(0.05)
        frames = rig.can_read()
        assert {frame.board for frame in frames} == {1, 2, 3}
        for board in range(4):
            data = rig.serial_read(board)
            others = [(f.identifier, round(f.time_s * 1e12) - CAN_BIT_PS) for f in frames if f.board != board]
            own = [(1, round(f.time_s * 1e12)) for f in frames if f.board == board]
            got = heard(data, "frame")
            assert got == others[: len(got)]
            assert len(got) >= len(others) - 2  # the last may end after the present
            assert heard(data, "sent") == own[: len(heard(data, "sent"))]


def test_the_hosts_frame_is_arbitrated_like_any_other(tmp_path):
    with Rig(small(tmp_path), FakeBoards()) as rig:
        rig.advance(0.01)
        rig.can_read()
        rig.can_write(0x0C064001, b"\x12\x34")
        rig.advance(0.01)
        mine = [frame for frame in rig.can_read() if frame.board == 4]
        assert [(f.identifier, f.data, f.acknowledged) for f in mine] == [(0x0C064001, b"\x12\x34", True)]
        assert 0.01 < mine[0].time_s < 0.0105
        for board in range(4):
            received_ps = round(mine[0].time_s * 1e12) - CAN_BIT_PS
            assert (0x0C064001, received_ps) in heard(rig.serial_read(board), "frame")


def test_without_a_host_on_the_bus_there_is_nothing_to_read_or_write(tmp_path):
    with Rig(small(tmp_path), FakeBoards(), host_on_can=False) as rig:
        rig.advance(0.01)
        assert rig.can_read() == []
        assert rig.can_statistics()["frames"] > 0
        with pytest.raises(UserError, match="not on the rig's CAN bus"):
            rig.can_write(1, b"")


def test_serial_bytes_arrive_back_to_back_from_the_present_on(tmp_path):
    message = bytes(range(200, 256)) * 4
    with Rig(small(tmp_path), FakeBoards()) as rig:
        rig.advance(0.01)
        rig.serial_write(message[:100])
        rig.serial_write(message[100:])
        rig.advance(0.01)
        got = heard(rig.serial_read(), "byte")
    assert bytes(value for value, _ in got) == message
    assert [time_ps for _, time_ps in got] == [10**10 + (k + 1) * BYTE_PS for k in range(len(message))]


def test_truth_is_the_pose_in_the_middle_of_a_cycle(tmp_path):
    scenario = small(tmp_path, kind=LINE)
    with Rig(scenario, FakeBoards()) as rig:
        lines = []
        for _ in range(10):
            rig.advance(0.01)
            lines += rig.truth()
        edges = rig.sync_edges_s()
    assert [line.cycle for line in lines] == list(range(len(edges) - 1))
    for line, start, end in zip(lines, edges[:-1], edges[1:], strict=True):
        middle = (start + end) / 2
        assert line.time_s == pytest.approx(middle, abs=1e-12)
        np.testing.assert_allclose(line.position_m, [0.5 + 0.5 * middle, 0.6 + 0.2 * middle, 0.4 + 0.1 * middle])
        turned = Rotation.from_rotvec(middle * np.array([0.0, 1.0, 0.5])) * Rotation.from_rotvec([0.1, -0.2, 0.3])
        assert (Rotation.from_quat(line.orientation_xyzw) * turned.inv()).magnitude() < 1e-7


def test_a_stopped_board_ends_the_run_with_a_sentence(tmp_path):
    with Rig(small(tmp_path), FakeBoards(stops={2: 10**10})) as rig:
        with pytest.raises(SystemFailure, match=r"beacon b stopped at 0\.0100\d* s: asked to stop at 10000000000"):
            rig.advance(1.0)
        assert rig.now_s == pytest.approx(0.01, abs=1e-4)


def test_faults(tmp_path):
    boards = FakeBoards(still=True)
    with Rig(small(tmp_path), boards) as rig:
        rig.watch_pins()
        rig.advance(0.01)
        rig.fault(1, "driver")
        rig.fault(2, "coil_open")
        rig.fault(3, "sense_shorted")
        rig.fault(0, "sync_wire_cut")
        rig.serial_read()
        rig.advance(0.01)
        assert [rig.coil_current_A(board) for board in (1, 2, 3)] == [0.0, 0.0, pytest.approx(10.0)]
        assert rig.pin_changes(1)[["pin", "level"]].tolist().count((ENABLE, False)) == 1
        assert boards.samples(3)["volts"][-1, 0] == 0.0
        assert boards.samples(2)["volts"][-1, 0] == pytest.approx(1.65, abs=0.01)
        assert len(heard(rig.serial_read(), "sync")) <= 2  # those on their way when the wire was cut
        rig.fault(2, "coil_open", active=False)
        rig.fault(0, "sync_wire_cut", active=False)
        rig.advance(0.01)
        assert rig.coil_current_A(2) == pytest.approx(10.0)
        assert len(heard(rig.serial_read(), "sync")) > 4
        with pytest.raises(UserError, match="there is no fault 'rain'"):
            rig.fault(1, "rain")
        rig.close()


def test_a_glitch_on_the_sync_wire_reaches_every_board_at_one_moment(tmp_path):
    boards = FakeBoards(still=True)
    with Rig(small(tmp_path), boards) as rig:
        rig.fault(2, "sync_wire_cut")
        rig.advance(0.01)
        at_ps = round(rig.now_s * 1e12) + 240 * 10**6
        rig.glitch(5e-6, after_s=2e-4)
        rig.advance(0.001)
        for board, on_the_wire in ((0, True), (1, True), (2, False), (3, True)):
            glitch = {(1, at_ps), (0, at_ps + 5 * 10**6)}
            assert (glitch <= set(heard(rig.serial_read(board), "sync"))) == on_the_wire
        with pytest.raises(UserError, match="lasts 1 ns to 10 ms and begins within 1 s, not 0 s"):
            rig.glitch(0.0)


def test_the_enable_needs_its_pull_down(tmp_path):
    """Before power-on no pin of a board is driven: only the pull-down keeps the bridge off."""
    on = {False: 0, True: 0}
    for lost in on:
        for seed in range(16):
            with Rig(small(tmp_path, power_on_spread_s="0.0"), FakeBoards(), seed) as rig:
                rig.watch_pins()
                if lost:
                    rig.fault(1, "pull_downs_lost")
                changes = rig.pin_changes(1)
                on[lost] += changes[changes["pin"] == ENABLE]["level"].tolist() == [True]
    assert on[False] == 0
    assert 3 <= on[True] <= 13


def test_a_motion_through_a_wire_is_the_scenarios_fault(tmp_path):
    with pytest.raises(UserError, match="scenario small: the sensor runs through a coil's wire"):
        Rig(small(tmp_path, position_m="[0.149, 0.0, 0.0]", rotation_vector_rad="[0.0, 0.0, 0.0]"), FakeBoards())


def test_unknown_boards_are_an_error(tmp_path):
    with pytest.raises(UserError, match="no boards of kind 'cardboard'; there are emulated, host"):
        Rig(small(tmp_path), "cardboard")


EVENTS = """
[[event]]
time_s = 0.01234
moves = "b"
by_m = [0.1, 0.0, 0.2]

[[event]]
time_s = 0.02
sheet = { centre_m = [0.5, 0.6, 0.1], normal = [0.0, 0.0, 1.0], side_m = 0.5 }
"""


@pytest.mark.parametrize("kind", ['"still"', LINE])
def test_an_event_changes_the_field_from_its_moment_on(tmp_path, kind):
    """The field of the coils' currents among moved coils and metal is the one at the sensor."""
    file = write_scenario(tmp_path, kind=kind, bandwidth_Hz="0.0")  # no lag between current and field
    file.write_text(file.read_text() + EVENTS)
    scene = scenarios.load(file)
    with Rig(scene, FakeBoards()) as rig:
        for until_s, time_s in ((0.0119, 0.0), (0.0121, 0.015), (0.0199, 0.015), (0.0201, 1.0)):
            rig.run_until(round(until_s * 1e12))
            now, sheets = scene.at(time_s), scene.metal_at(time_s)
            coils = [beacon.geometry for beacon in now.beacons]
            if sheets:
                coils = [BesideMetal(coil, Metal(sheets)) for coil in coils]
            columns = path.columns(coils, now.motion, np.array([rig.now_s]))[0]
            current_A = [rig.coil_current_A(board) for board in (1, 2, 3)]
            expected = current_A @ columns[:9].reshape(3, 3) + columns[9:18].reshape(3, 3) @ [2e-5, 0.0, -4.5e-5]
            np.testing.assert_allclose(rig.sensor_field_T(), expected, rtol=1e-5)
            other = scene.at(1.0 if time_s == 0.0 else 0.0)
            before = path.columns([beacon.geometry for beacon in other.beacons], now.motion, np.array([rig.now_s]))[0]
            assert np.abs(columns[:9] - before[:9]).max() > 1e-2 * np.abs(columns[:9]).max()


def dipole_T(moment, away):
    """Return the field of a dipole at a distance, by its textbook formula."""
    distance = np.linalg.norm(away)
    return 1e-7 * (3.0 * np.dot(moment, away) * away / distance**5 - moment / distance**3)


@pytest.mark.parametrize("kind", ['"still"', LINE])
def test_a_magnet_passes_from_its_first_moment_to_its_last(tmp_path, kind):
    file = write_scenario(tmp_path, kind=kind)
    magnet = "[[magnet]]\nmoment_A_m2 = [3.0, -2.0, 1.0]\nposition_m = [0.2, 1.0, 0.5]\n"
    file.write_text(f"{file.read_text()}\n{magnet}velocity_m_per_s = [20.0, 0.0, 0.0]\nstart_s = 0.01\nstop_s = 0.03\n")
    with_magnet, without = scenarios.load(file), scenarios.load(write_scenario(tmp_path, kind=kind))
    with Rig(with_magnet, FakeBoards()) as rig, Rig(without, FakeBoards()) as quiet:
        for until_s in (0.0099, 0.0101, 0.02, 0.0299, 0.0301):
            for one in (rig, quiet):
                one.run_until(round(until_s * 1e12))
            position, rotation = with_magnet.motion.poses(np.array([rig.now_s]))
            place = np.array([0.2 + 20.0 * (rig.now_s - 0.01), 1.0, 0.5])
            there = 0.01 <= until_s < 0.03
            expected = (
                rotation[0].inv().apply(dipole_T(np.array([3.0, -2.0, 1.0]), position[0] - place)) if there else 0.0
            )
            added = rig.sensor_field_T() - quiet.sensor_field_T()
            np.testing.assert_allclose(added, np.broadcast_to(expected, 3), rtol=1e-4, atol=1e-15)
            assert (np.linalg.norm(added) > 1e-7) == there


def test_surroundings_change_at_their_moment(tmp_path):
    file = write_scenario(tmp_path, kind='"still"')
    mains = "mains = { frequency_Hz = 50.0, amplitude_T = [0.0, 1e-6, 0.0], phase_rad = 1.5707963267948966 }"
    file.write_text(
        f"{file.read_text()}\n[[event]]\ntime_s = 0.02\nambient = {{ earth_T = [0.0, 0.0, 3e-5], {mains} }}\n"
    )
    scene = scenarios.load(file)
    with (
        Rig(scene, FakeBoards()) as rig,
        Rig(scenarios.load(write_scenario(tmp_path, kind='"still"')), FakeBoards()) as quiet,
    ):
        for until_s, there in ((0.0199, False), (0.0201, True), (0.033, True)):
            for one in (rig, quiet):
                one.run_until(round(until_s * 1e12))
            turned = scene.motion.poses(np.array([rig.now_s]))[1][0].apply(
                rig.sensor_field_T() - quiet.sensor_field_T()
            )
            # cos(2 pi 50 Hz t) is what a sine a quarter ahead is.
            expected = np.array([-2e-5, 1e-6 * np.cos(100.0 * np.pi * rig.now_s), 7.5e-5]) if there else np.zeros(3)
            np.testing.assert_allclose(turned, expected, atol=3e-9)


def test_a_sensor_fails_by_an_event_and_is_whole_again(tmp_path):
    file = write_scenario(tmp_path, kind='"still"')
    fault = '[[event]]\ntime_s = {}\nsensor_fault = "{}"\naxis = 1\n'
    file.write_text("\n".join([file.read_text(), fault.format(0.01, "high"), fault.format(0.02, "sound")]))
    boards = FakeBoards()
    with Rig(scenarios.load(file), boards) as rig:
        rig.advance(0.03)
    samples = boards.samples(0)
    failed = (samples["time_ps"] >= 10**10) & (samples["time_ps"] < 2 * 10**10)
    assert np.count_nonzero(failed) > 50
    assert (samples["volts"][failed, 1] == 3.3).all()
    assert (samples["volts"][~failed] < 3.3).all()
    assert (samples["volts"][failed][:, [0, 2]] < 3.3).all()


def test_slices_do_not_matter_to_events(tmp_path):
    file = write_scenario(tmp_path, **MOVING)
    file.write_text(file.read_text() + EVENTS)
    scene = scenarios.load(file)
    assert record(scene, [0.03]) == record(scene, [0.0011, 0.0122, 0.0125, 0.0199999, 0.03])


def test_a_supply_sags_and_a_coil_breaks_when_the_scenario_says(tmp_path):
    events = """
    [[event]]
    time_s = 0.01
    beacon = "b"
    supply_V = 0.9
    [[event]]
    time_s = 0.02
    beacon = "c"
    fault = "coil_open"
    [[event]]
    time_s = 0.03
    beacon = "c"
    fault = "coil_open"
    mended = true
    """
    path = write_scenario(tmp_path)
    path.write_text(path.read_text() + events)
    with Rig(scenarios.load(path), FakeBoards(still=True)) as rig:
        rig.advance(0.0099)
        assert rig.coil_current_A(2) == pytest.approx(10.0)
        rig.advance(0.0101)
        assert rig.coil_current_A(2) == pytest.approx(0.9 / 0.15, abs=0.01)
        assert rig.coil_current_A(3) == pytest.approx(10.0)
        rig.advance(0.005)
        assert rig.coil_current_A(3) == 0.0
        rig.advance(0.01)
        assert rig.coil_current_A(3) == pytest.approx(10.0)
        assert rig.coil_temperature_degC(1) == 20.0

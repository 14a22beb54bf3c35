"""Poses that the sensor computed: its messages in a log, and a live sensor that gets the beacon table."""

import json
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.sensor.on_sensor import OnSensorTrack, on_sensor_parameters
from goldfield.sensor.options import Method, Options
from goldfield.site.reading import ASSUMED_AXIS_SD_RAD, ASSUMED_GAIN_SD, ASSUMED_SURVEY
from goldfield.types import Status
from goldfield_protocol import decode, encode
from goldfield_protocol.parameters import PARAMETERS, parse_page
from hil_sim.scenario import SCENARIOS, load_scenario, parameter_page, site_toml
from tests.host.fake_sensor import ATTITUDE, NODE, POSITION_M, SITE, candump, cycle_messages, heartbeat

STEP = 1.0 / 16384.0
OWN_M = np.add(POSITION_M, [0.01, 0.0, 0.0])


def pose_messages(cycle, status=0, used=8, reason=0, left_out=255, protection=0.09):
    low = {"cycle_low": cycle % 16}
    position = dict(zip("xyz", map(float, OWN_M), strict=True))
    attitude = dict(zip("xyzw", (np.round(ATTITUDE.as_quat() / STEP) * STEP).tolist(), strict=True))
    quality = {"status": status, "tracked": 1, "used": used, "iterations": 5, "residual": 0.97}
    quality |= {"sigma_position": 0.0072, "sigma_attitude": 0.015}
    return [
        encode("POSE_POSITION", position | low, node=NODE),
        encode("POSE_ATTITUDE", attitude | low, node=NODE),
        encode("POSE_QUALITY", quality | low, node=NODE),
        encode("POSE_INTEGRITY", {"reason": reason, "left_out": left_out, "protection": protection} | low, node=NODE),
    ]


def run(capsys, tmp_path, messages, *options):
    log = tmp_path / "a.log"
    log.write_text(candump([(0.001 * i, message) for i, message in enumerate(messages)]))
    code = main(["run", "--site", str(SITE), "--log", str(log), "--json", *options])
    captured = capsys.readouterr()
    return code, [json.loads(line) for line in captured.out.splitlines()], captured.err


def test_messages_of_the_dbc_bit_by_bit():
    """Packed by hand: the layout in the C code, in the DBC and here is the same."""
    identifier, data = encode("POSE_POSITION", {"x": -1.0, "y": 0.1, "z": 52.4287, "cycle_low": 9}, node=7)
    assert identifier == 16 << 24 | 7
    assert int.from_bytes(data, "little") == (-10000 & 0xFFFFF) | 1000 << 20 | 524287 << 40 | 9 << 60
    identifier, data = encode("POSE_ATTITUDE", {"x": -0.5, "y": 0.25, "z": 0.0, "w": 0.75, "cycle_low": 1}, node=7)
    assert identifier == 17 << 24 | 7
    assert int.from_bytes(data, "little") == (-8192 & 0x7FFF) | 4096 << 15 | 12288 << 45 | 1 << 60
    signals = {"cycle_low": 15, "status": 3, "tracked": 1, "used": 64, "iterations": 200, "residual": 1.25}
    identifier, data = encode("POSE_QUALITY", signals | {"sigma_position": 0.5, "sigma_attitude": 0.01}, node=7)
    assert identifier == 18 << 24 | 7
    assert int.from_bytes(data, "little") == (
        15 | 3 << 4 | 1 << 7 | 64 << 8 | 200 << 15 | 125 << 23 | 5000 << 35 | 20 << 51
    )
    signals = {"cycle_low": 15, "reason": 11, "left_out": 63, "protection": 0.25}
    identifier, data = encode("POSE_INTEGRITY", signals, node=7)
    assert identifier == 24 << 24 | 7
    assert int.from_bytes(data, "little") == 15 | 11 << 4 | 63 << 8 | 250 << 16


def test_a_log_with_the_sensors_poses(capsys, tmp_path):
    messages = [heartbeat()]
    for cycle in range(4, 8):
        messages += cycle_messages(cycle) + pose_messages(cycle)
    code, own, _ = run(capsys, tmp_path, messages, "--on-sensor")
    assert code == 0
    assert [line["epoch"] for line in own] == [4, 5, 6, 7]
    for line in own:
        np.testing.assert_allclose(line["position_m"], OWN_M, atol=1e-6)
        assert (Rotation.from_quat(line["orientation_xyzw"]) * ATTITUDE.inv()).magnitude() < 1e-4
        assert (line["status"], len(line["used"]), line["lost"]) == ("ok", 8, 0)
        assert line["residual"] == pytest.approx(0.97)
        assert np.sqrt(np.trace(line["position_cov_m2"])) == pytest.approx(0.0072)
        assert np.sqrt(np.trace(line["attitude_cov_rad2"])) == pytest.approx(0.015)
    # Without the option they are not looked at.
    code, host, _ = run(capsys, tmp_path, messages)
    assert [line["lost"] for line in host] == [0] * 4
    assert all(np.linalg.norm(np.subtract(line["position_m"], POSITION_M)) < 0.05 for line in host)


def test_a_lost_pose_message_costs_that_epoch_only(capsys, tmp_path):
    messages = [heartbeat()]
    for cycle in range(4, 8):
        of_pose = pose_messages(cycle, status=2 if cycle == 7 else 0, used=6 if cycle == 7 else 8)
        messages += cycle_messages(cycle) + (of_pose[:2] if cycle == 5 else of_pose)
    _, lines, _ = run(capsys, tmp_path, messages, "--on-sensor")
    assert [line["status"] for line in lines] == ["ok", "failed", "ok", "weak"]
    assert lines[1]["position_m"] is None
    assert lines[3]["used"] == ["?"] * 6


def test_reason_beacon_left_out_and_protection(capsys, tmp_path):
    names = [beacon.id for beacon in sites.load(SITE).beacons]
    messages = [heartbeat()]
    for cycle, told in enumerate(
        (
            {},
            {"reason": 11, "left_out": 2, "used": 7},
            {"status": 3, "reason": 4, "protection": 1048.575},
            {"status": 4, "reason": 2},
            {"status": 5, "reason": 10, "protection": 0.8},
        ),
        start=4,
    ):
        messages += cycle_messages(cycle) + pose_messages(cycle, **told)
    _, lines, _ = run(capsys, tmp_path, messages, "--on-sensor")
    assert [line["status"] for line in lines] == ["ok", "ok", "inconsistent", "failed", "unverified"]
    assert [line["excluded"] for line in lines[:3]] == [[], [names[2]], []]
    assert lines[1]["used"] == names[:2] + names[3:]
    assert lines[0]["reason"] is None
    assert lines[1]["reason"] == f"{names[2]} does not agree with the site and was left out"
    assert "left-handed" in lines[2]["reason"]
    assert lines[3]["reason"] == "the fields are nothing but noise"
    assert "alert limit" in lines[4]["reason"]
    assert [line["protection_m"] for line in lines] == [0.09, 0.09, None, None, 0.8]


def test_a_sensor_without_poses(capsys, tmp_path):
    messages = [heartbeat(), *cycle_messages(4), *cycle_messages(5)]
    code, lines, _ = run(capsys, tmp_path, messages, "--on-sensor")
    assert code == 0
    assert [line["status"] for line in lines] == ["failed", "failed"]


def test_what_cannot_be_is_said(capsys, tmp_path):
    code, _, err = run(capsys, tmp_path, [heartbeat()], "--on-sensor", "--track")
    assert code == 2
    assert "--on-sensor and --track are both given" in err
    site = tmp_path / "site.toml"
    site.write_text(SITE.read_text().replace("code = 9", "code = 1024"))
    code = main(["run", "--site", str(site), "--log", "x.log", "--on-sensor"])
    assert code == 2
    assert "none of them 1024" in capsys.readouterr().err


def test_the_table_from_the_site_is_that_of_the_rig(tmp_path):
    """Two ways to the same parameters: the scenario's page, and the site file that the scenario writes."""
    scenario = load_scenario("prigge8")
    path = tmp_path / "site.toml"
    path.write_text(site_toml(scenario))
    page = parse_page(parameter_page(scenario, 0))
    values = on_sensor_parameters(sites.load(path))
    for name in ("pose", "noise", "half_space", "beacons", "survey", "gain_sd", "axis_sd"):
        stored = page[name] if isinstance(page[name], list) else [page[name]]
        given = [values[PARAMETERS[name].identifier(i)] for i in range(len(stored))]
        np.testing.assert_allclose(given, stored, rtol=1e-6)
    assert values[PARAMETERS["alert_limit"].identifier(0)] == 0.5  # the board's own default, too
    assert len(values) == 12 + (8 + 3) * 8


def test_the_declared_errors_of_each_beacon_reach_the_sensor(tmp_path):
    text = SITE.read_text().replace("current_sd = 0.0", "current_sd = 0.02").replace("gain_sd = 0.0", "gain_sd = 0.004")
    path = tmp_path / "site.toml"
    path.write_text(text.replace('id = "b2"', 'id = "b2"\nposition_sd_m = 0.03'))
    site = sites.load(path)
    values = on_sensor_parameters(site)
    row = [beacon.id for beacon in site.beacons].index("b2")
    declared = [values[PARAMETERS["survey"].identifier(3 * row + i)] for i in range(3)]
    assert declared == [0.03, 0.0, 0.02]
    assert values[PARAMETERS["survey"].identifier(0)] == 0.0
    assert values[PARAMETERS["gain_sd"].first] == 0.004
    assert values[PARAMETERS["axis_sd"].first] == 0.0


def test_a_board_assumes_what_the_host_assumes():
    """The defaults of a board without a page are those of a site file that is silent."""
    survey = ASSUMED_SURVEY
    assert PARAMETERS["survey"].default == (survey.position_sd_m, survey.axis_sd_rad, survey.current_sd)
    assert PARAMETERS["gain_sd"].default == (ASSUMED_GAIN_SD,)
    assert PARAMETERS["axis_sd"].default == (ASSUMED_AXIS_SD_RAD,)


def test_a_live_sensor_that_knows_no_beacons_gets_them(tmp_path):
    """Boards of the rig as one process, the command as another: parameters and poses through the serial port."""
    scenario = tmp_path / "bare.toml"
    text = (SCENARIOS / "prigge8.toml").read_text().replace("pose = 1 ", "pose = 0 ")
    scenario.write_text(text)
    site = tmp_path / "site.toml"
    site.write_text(site_toml(load_scenario(str(scenario))))
    goldfield = [sys.executable, "-m", "goldfield"]
    rig_command = [*goldfield, "hil", str(scenario), "--boards", "host", "--wait", "--json", "--can", "none"]
    rig_command += ["--truth", str(tmp_path / "truth.jsonl")]  # else on the pipe, which nobody reads
    with subprocess.Popen(rig_command, stdout=subprocess.PIPE, text=True) as rig:
        try:
            port = json.loads(rig.stdout.readline())["serial"]
            options = ["--port", port, "--site", str(site), "--on-sensor", "--json", "--seconds", "1.5"]
            done = subprocess.run([*goldfield, "run", *options], capture_output=True, text=True, check=False)
        finally:
            rig.terminate()
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines) >= 14
    located = [line for line in lines if line["status"] == "ok"]
    assert len(located) >= len(lines) - 3  # At first the table may be incomplete.
    errors = [np.linalg.norm(np.subtract(line["position_m"], [0.9, 1.2, 0.8])) for line in located]
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def block_pose_messages(site, cycle, chip, **told):
    """The messages of the pose at the end of a code chip, with an offset in x that tells the moment."""
    offset = 1e-3 * (cycle + (chip + 1) / site.chips)
    for identifier, data in pose_messages(cycle, **told):
        message = decode(identifier, data)
        signals = dict(message.signals)
        if message.name == "POSE_POSITION":
            signals["x"] += offset
        yield decode(*encode(message.name, signals, node=NODE, index=1 + chip))


def epoch_message(cycle, time_s):
    return decode(*encode("EPOCH", {"cycle": cycle, "time": time_s}, node=NODE))


def fed(track, messages):
    return [pose for message in messages if (pose := track.feed(message)) is not None]


def test_poses_of_blocks_are_stamped_with_their_ends():
    """The sensor's clock runs 80 ppm fast; a block may end in a cycle before the latest EPOCH's, and two behind it."""
    site = sites.load(SITE)
    track = OnSensorTrack(site)
    length_s = site.cycle_s * 1.00008
    assert fed(track, block_pose_messages(site, 5, 30)) == []  # before any EPOCH nobody knows the time
    poses = []
    for cycle in range(14, 19):  # the low bits wrap
        poses += fed(track, [epoch_message(cycle, (cycle + 0.5) * length_s)])
        for ended, chip in ((cycle, 1022), (cycle + 1, 0), (cycle + 1, 511), (cycle + 2, 30)):
            poses += fed(track, block_pose_messages(site, ended, chip))
    assert len(poses) == 20
    for i, pose in enumerate(poses):
        told = (pose.position_m[0] - OWN_M[0]) / 1e-3  # within half of .1 mm
        assert pose.time_s / length_s == pytest.approx(told, abs=0.06)
        assert pose.epoch == 14 + i // 4 + (0, 1, 1, 2)[i % 4]
    ends = [pose.time_s - (14 + i // 4) * length_s for i, pose in enumerate(poses)][4:8]
    np.testing.assert_allclose(
        ends, np.array([1.0, 1.0 + 1 / 1023, 1.0 + 512 / 1023, 2.0 + 31 / 1023]) * length_s, atol=1e-6
    )


def test_a_block_whose_messages_are_lost_is_counted_and_not_mixed():
    site = sites.load(SITE)
    for missing in range(4):
        track = OnSensorTrack(site)
        assert fed(track, [epoch_message(4, 0.45)]) == []
        rows = [list(block_pose_messages(site, cycle, 30)) for cycle in (5, 6, 7)]  # one block a cycle: one index
        rows[1].pop(missing)
        poses = fed(track, [message for row in rows for message in row])
        assert [pose.epoch for pose in poses] == [5, 7]
        assert track.lost == 1


def test_poses_of_a_longer_code_are_ignored():
    site = sites.load(SITE)
    track = OnSensorTrack(site)
    messages = [epoch_message(4, 0.45), *block_pose_messages(site, 5, 1023), *block_pose_messages(site, 5, 1022)]
    (pose,) = fed(track, messages)
    assert pose.time_s == pytest.approx(6 * site.cycle_s, abs=2e-3)


def test_status_and_reason_of_a_blocks_pose():
    site = sites.load(SITE)
    track = OnSensorTrack(site)
    fed(track, [epoch_message(4, 0.45)])
    (failed,) = fed(track, block_pose_messages(site, 5, 30, status=4, reason=2))
    assert (failed.status, failed.reason) == (Status.FAILED, "the fields are nothing but noise")
    assert np.isnan(failed.position_m).all()
    (rest,) = fed(track, block_pose_messages(site, 5, 61, reason=11, left_out=2, used=7))
    assert (rest.status, rest.excluded) == (Status.OK, (site.beacons[2].id,))


def test_cycles_do_not_take_the_poses_of_blocks(capsys, tmp_path):
    """They come between the messages of a cycle, and look like its own but for the index."""
    site, messages = sites.load(SITE), [heartbeat()]
    for cycle in range(4, 8):
        of_block = [
            encode(m.name, m.signals, node=NODE, index=m.index) for m in block_pose_messages(site, cycle, 30, status=4)
        ]
        messages += of_block + cycle_messages(cycle) + pose_messages(cycle)
    code, lines, _ = run(capsys, tmp_path, messages, "--on-sensor")
    assert code == 0
    assert [line["status"] for line in lines] == ["ok"] * 4


def test_the_number_of_blocks_is_among_the_parameters():
    site, identifier = sites.load(SITE), PARAMETERS["pose_blocks"].identifier(0)
    assert [on_sensor_parameters(site, n)[identifier] for n in (0, 3)] == [0, 3]


def test_a_rate_below_the_sensors_least_is_told_before_it_is_asked():
    """The sensor refused pose_blocks = 330006, as if it had failed."""
    site, block_s = sites.load(SITE), 31 * 97.75e-6
    Options(Method.ON_SENSOR, rate_hz=1.0 / (1023.4 * block_s)).check(site)
    for rate in (1.0 / (1023.6 * block_s), 1e-3, 1e-320):
        with pytest.raises(UserError, match=r"less often than a sensor sends poses of blocks, 0\.323 Hz"):
            Options(Method.ON_SENSOR, rate_hz=rate).check(site)
    Options(Method.TRACK, rate_hz=1e-3).check(site)


def test_the_first_cycles_without_a_pose_of_a_block_are_not_told_as_none_at_all(capsys, tmp_path):
    site = sites.load(SITE)
    messages = [heartbeat()]
    for cycle in range(4, 12):
        messages += cycle_messages(cycle) + pose_messages(cycle)
        if cycle > 5:
            poses = block_pose_messages(site, cycle, 1022)
            messages += [encode(one.name, dict(one.signals), node=NODE, index=one.index) for one in poses]
    _, _, said = run(capsys, tmp_path, messages, "--on-sensor", "--rate", "10")
    assert "which a rate needs" not in said
    none = [message for message in messages if decode(*message).index == 0 or decode(*message).name == "FIELD"]
    _, _, said = run(capsys, tmp_path, none, "--on-sensor", "--rate", "10")
    assert "the sensor sends no poses of blocks, which a rate needs" in said

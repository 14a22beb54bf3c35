"""`goldfield run`: live on a pseudo-terminal, on a recorded log, beside the truth, and with what goes wrong."""

import contextlib
import json
import math
import re
import subprocess
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.link.buses import open_can
from goldfield.types import Pose, Status
from goldfield.view.truth import Truth, rotation_angle
from goldfield_protocol import encode
from tests.host.fake_sensor import (
    ATTITUDE,
    CODES,
    POSITION_M,
    SITE,
    TOO_SLOW,
    PtySensor,
    beacon_fields,
    candump,
    cycle_messages,
    heartbeat,
    log_of,
)

LOCATE_KEYS = ["epoch", "t_s", "position_m", "orientation_xyzw", "position_cov_m2", "attitude_cov_rad2"]
LOCATE_KEYS += ["residual", "status", "used", "excluded", "reason", "protection_m", "alternative", "beacons"]


LATENCY = (
    r"from the last message to the line: median [\d.]+ ms, 95 % within [\d.]+ ms, 99 % within [\d.]+ ms "
    r"\(median [\d.]+ ms, 95 % within [\d.]+ ms, 99 % within [\d.]+ ms of it computing\); \d+ % of a processor\n"
).replace(" ", r"\s+")


def no_constants(name):
    raise AssertionError(f"{name} is no JSON")


def run(capsys, *options):
    code = main(["run", "--site", str(SITE), *map(str, options)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def poses(out):
    return [json.loads(line, parse_constant=no_constants) for line in out.splitlines()]


def write(tmp_path, text, name="a.log"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def truth_lines(cycles, offset=(0.0, 0.0, 0.0)):
    orientation = ATTITUDE.as_quat().tolist()
    position = (POSITION_M + offset).tolist()
    record = {"position_m": position, "orientation_xyzw": orientation}
    return "".join(json.dumps({"cycle": c, "t_s": 0.1 * c} | record) + "\n" for c in cycles)


def test_a_log_gives_poses(tmp_path, capsys):
    path = write(tmp_path, log_of(range(4, 8), [heartbeat()]))
    code, out, err = run(capsys, "--log", path, "--json")
    assert code == 0
    lines = poses(out)
    assert [line["epoch"] for line in lines] == [4, 5, 6, 7]
    for line in lines:
        assert list(line) == [*LOCATE_KEYS, "lost", "chips", "saturated", "locked"]
        assert line["status"] == "ok"
        assert line["lost"] == 0
        assert np.linalg.norm(np.subtract(line["position_m"], POSITION_M)) < 0.05
        assert 0.5 < line["residual"] < 2.0
    assert err == "4 epochs: 4 ok\n"


def test_errors_of_separation_are_the_noise_of_the_messages(tmp_path, capsys):
    """Without noise what is left is the messages' resolution of 0.1 nT: the pose is right to a millimetre."""
    messages = [(0.1, m) for m in cycle_messages(0, noise_T=0.0)]
    _, out, _ = run(capsys, "--log", write(tmp_path, candump(messages)), "--json")
    (line,) = poses(out)
    assert np.linalg.norm(np.subtract(line["position_m"], POSITION_M)) < 1e-3


def test_lost_messages_show_and_the_rest_is_used(tmp_path, capsys):
    lines = log_of(range(3)).splitlines(keepends=True)
    del lines[11 + 5]  # a field of cycle 1
    del lines[22 - 1 : 22]  # the header of cycle 2
    lines.insert(8, "(0.1) can0 garbage\n")
    code, out, err = run(capsys, "--log", write(tmp_path, "".join(lines)), "--json")
    assert code == 0
    first, second, third = poses(out)
    assert (first["lost"], len(first["used"])) == (0, 8)
    assert (second["lost"], len(second["used"])) == (1, 7)
    assert third["lost"] == 1
    assert third["t_s"] == pytest.approx(2.5 * 1023 * 97.75e-6, abs=1e-5)
    assert "2 messages lost, 1 corrupt frame" in " ".join(err.split())


def test_an_epoch_without_anything_still_has_its_line(tmp_path, capsys):
    text = log_of([3, 5])
    _, out, _ = run(capsys, "--log", write(tmp_path, text), "--json")
    assert [(p["epoch"], p["status"], p["position_m"] is None, p["lost"]) for p in poses(out)] == [
        (3, "ok", False, 0),
        (4, "failed", True, 11),
        (5, "ok", False, 0),
    ]


def test_fields_written_give_the_same_poses(tmp_path, capsys):
    lines = log_of(range(3)).splitlines(keepends=True)
    del lines[11 + 5]
    table = tmp_path / "fields.csv"
    code, out, _ = run(capsys, "--log", write(tmp_path, "".join(lines)), "--json", "--fields", table)
    assert code == 0
    assert len(table.read_text().splitlines()) == 1 + 8 + 7 + 8
    assert main(["locate", "--site", str(SITE), str(table), "--json"]) == 0
    again = poses(capsys.readouterr().out)
    for live, located in zip(poses(out), again, strict=True):
        np.testing.assert_allclose(located["position_m"], live["position_m"], atol=1e-9)
        assert located["used"] == live["used"]
    code, _, err = run(capsys, "--log", tmp_path / "a.log", "--fields", tmp_path / "none" / "f.csv")
    assert (code, err.count("\n")) == (2, 1)
    assert "the fields cannot be written" in err


def test_what_the_sensor_says_was_wrong_is_shown(tmp_path, capsys):
    messages = cycle_messages(0)
    status = {"cycle_low": 0, "chips": 1000, "saturated": 4, "fields": 8, "locked": 0, "phase": 0, "temperature": 20}
    messages[1] = encode("EPOCH_STATUS", status, node=100)
    messages += [encode("COUNTER", {"counter": n, "value": n + 1}, node=100, index=n) for n in (6, 77)]
    path = write(tmp_path, candump([(0.1, m) for m in messages]))
    code, out, _ = run(capsys, "--log", path)
    assert code == 0
    words = " ".join(out.split())
    assert "  failed\n        not synchronised, 23 chips lost, 4 chips saturated" in out
    assert words.count("the clock of sensor 100 is not locked: check its sync wire") == 2
    assert "the fields are nothing but noise" in words, "the lost chips leave so much of the earth's field in them"
    counted = out.splitlines()[-1]
    assert counted == "the sensor counted since its reset: 7 converter overruns, 78 of counter 77"
    (record,) = poses(run(capsys, "--log", path, "--json")[1])
    assert (record["chips"], record["saturated"], record["locked"]) == (1000, 4, False)
    assert record["status"] == "failed"
    assert record["reason"].startswith("the clock of sensor 100 is not locked")


def test_the_summary_tells_of_other_boards_and_of_the_way(tmp_path, capsys):
    messages = [
        heartbeat(),
        heartbeat(node=2, role=0),
        encode("COUNTER", {"counter": 12, "value": 3}, node=2, index=12),
        encode("SYNC", {"cycle": 0, "chips": 1023, "chip_period": 97750.0, "rank": 1}, node=2),
        encode("SYNC", {"cycle": 0, "chips": 1023, "chip_period": 97750.0, "rank": 1}, node=3),
        encode("SYNC", {"cycle": 1, "chips": 1023, "chip_period": 97750.0, "rank": 1}, node=2),
        *cycle_messages(0),
        cycle_messages(0)[5],
    ]
    code, out, _ = run(capsys, "--log", write(tmp_path, candump([(0.1, m) for m in messages])))
    assert code == 0
    assert " ".join(out.partition("1 epoch")[2].split()) == (
        ": 1 inconsistent in 1 of 1: nodes 2 and 3 are both sync masters: set sync_master = 1 in one board only "
        "the link: 1 message that came after their epoch node 2 counted: 3 open coil"
    )


def test_codes_of_another_site_do_not_matter(tmp_path, capsys):
    other = cycle_messages(0, codes=CODES)[3:5]
    foreign = [(identifier + (0x300 << 12), data) for identifier, data in other]
    messages = cycle_messages(0)
    code, out, _ = run(
        capsys, "--log", write(tmp_path, candump([(0.1, m) for m in [*messages[:3], *foreign, *messages[3:]]]))
    )
    assert code == 0
    assert out.splitlines()[1].endswith("ok")


def test_live_on_a_serial_port_recorded_and_replayed_alike(tmp_path, capsys):
    record = tmp_path / "record.log"
    with PtySensor(range(20), garbage=b"\x13\x37\0") as sensor:
        code, out, err = run(capsys, "--port", sensor.path, "--seconds", 0.6, "--json", "--record", record)
    assert code == 0
    assert [p["epoch"] for p in poses(out)] == list(range(6))
    assert all(p["status"] == "ok" for p in poses(out))
    told = TOO_SLOW.sub("", err)
    counts = re.fullmatch(r"6 epochs: 6 ok\nthe link: (\d+) corrupt frames\n" + LATENCY, told)
    assert counts is not None
    assert int(counts[1]) >= 6  # one for each piece of garbage
    code, again, _ = run(capsys, "--log", record, "--json", "--seconds", 0.6)
    assert code == 0
    assert again == out


def test_live_on_can(capsys):
    sender = open_can("virtual:cli")
    stop = threading.Event()

    def answer():
        cycle = 0
        while not stop.is_set():
            sender.send(*heartbeat())
            for message in cycle_messages(cycle):
                sender.send(*message)
            cycle += 1
            while (request := sender.receive(0.02)) is not None:
                index = request.arbitration_id >> 12 & 0xFFF
                value = {5: len(CODES), 28: 10, 46: 0}[index] if index < 256 else CODES[index - 256]
                sender.send((0x0E << 24) | index << 12 | 100, bytes([0]) + value.to_bytes(4, "little"))

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    code, out, _ = run(capsys, "--can", "virtual:cli", "--seconds", 0.3, "--json")
    stop.set()
    thread.join()
    sender.close()
    assert code == 0
    assert [p["status"] for p in poses(out)] == ["ok"] * 3


def test_a_pulled_cable_ends_the_run_with_what_came_before(capsys):
    with PtySensor(range(4), hang_up=True) as sensor:
        code, out, err = run(capsys, "--port", sensor.path, "--json")
    assert code == 3
    assert f"goldfield: {sensor.path}: the port is gone" in err
    assert "Traceback" not in err
    whole = [p["epoch"] for p in poses(out) if p["lost"] == 0]
    assert whole == list(range(len(whole)))
    assert all(p["status"] == "ok" for p in poses(out)[: len(whole)])
    assert len(poses(out)) - len(whole) <= 1  # the cycle that was cut: whatever its fields tell


def test_another_protocol_live_and_in_a_log(tmp_path, capsys):
    with PtySensor([], hash_=1) as sensor:
        code, _, err = run(capsys, "--port", sensor.path)
    assert (code, err.count("\n")) == (2, 1)
    assert "make flash ROLE=sensor" in err
    code, _, err = run(capsys, "--log", write(tmp_path, log_of([1], [heartbeat(hash_=1)])))
    assert (code, err.count("\n")) == (2, 1)
    assert err.endswith(": read the recording with the version of goldfield that made it\n")


BAD = [
    ([], "no source is given"),
    (["--port", "a", "--log", "b"], "more than one source is given"),
    (["--port", ""], "--port is empty"),
    (["--port", "/dev/no-such-port"], "/dev/no-such-port: there is no such port"),
    (["--port", "."], "is a directory"),
    (["--log", "/no/such.log"], "/no/such.log: there is no such log"),
    (["--log", "."], "is a directory"),
    (["--log", str(SITE)], "prigge8_site.toml:1: the log holds no message"),
    (["--can", "socketcan"], "is not INTERFACE:CHANNEL"),
    (["--can", "nonsense:0"], "knows no interface nonsense"),
    (["--can", "slcan:/dev/no-such-port"], "--can slcan:/dev/no-such-port: cannot be opened"),
]


@pytest.mark.parametrize(("options", "words"), BAD)
def test_bad_usage_is_one_sentence(capsys, options, words):
    code, out, err = run(capsys, *options)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err


@pytest.mark.parametrize(
    ("option", "value"), [("--seconds", "0"), ("--seconds", "x"), ("--seconds", "nan"), ("--node", "4096")]
)
def test_bad_numbers(capsys, option, value):
    with pytest.raises(SystemExit) as ended:
        main(["run", option, value])
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_log_of_other_messages(tmp_path, capsys):
    code, _, err = run(capsys, "--log", write(tmp_path, candump([(0.0, heartbeat(node=3, role=0))])))
    assert code == 2
    assert "a.log: holds no cycle of a sensor" in err


def test_the_environment_gives_the_source_unless_the_command_line_does(tmp_path, capsys, monkeypatch):
    path = write(tmp_path, log_of([1]))
    monkeypatch.setenv("GOLDFIELD_PORT", "/dev/no-such-port")
    assert run(capsys)[0] == 2
    assert run(capsys, "--log", path)[0] == 0
    monkeypatch.delenv("GOLDFIELD_PORT")
    monkeypatch.setenv("GOLDFIELD_LOG", str(path))
    monkeypatch.setenv("GOLDFIELD_SECONDS", "0.1")
    assert run(capsys)[0] == 0
    monkeypatch.setenv("GOLDFIELD_SECONDS", "never")
    with pytest.raises(SystemExit):
        main(["run"])


def test_errors_against_the_truth(tmp_path, capsys):
    path = write(tmp_path, log_of(range(3)))
    truth = write(tmp_path, truth_lines(range(3), offset=(0.0, 0.3, 0.4)), "truth.jsonl")
    code, out, err = run(capsys, "--log", path, "--json", "--truth", truth)
    assert code == 0
    lines = poses(out)
    for line in lines:
        distance = np.linalg.norm(np.subtract(line["position_m"], np.add(POSITION_M, [0.0, 0.3, 0.4])))
        assert line["position_error_m"] == pytest.approx(distance)
        turn = (Rotation.from_quat(line["orientation_xyzw"]).inv() * ATTITUDE).magnitude()
        assert line["attitude_error_rad"] == pytest.approx(turn)
    rms = math.sqrt(np.mean([line["position_error_m"] ** 2 for line in lines]))
    assert f"rms error of 3 ok poses: position {rms * 100:.2f} cm" in err
    code, out, _ = run(capsys, "--log", path, "--truth", truth)
    header, *rows, _, summary = out.splitlines()
    assert "   yaw sd cm  e cm e deg pl cm" in header
    assert float(rows[0].split()[8]) == pytest.approx(lines[0]["position_error_m"] * 100, abs=0.006)
    assert summary.startswith("rms error of 3 ok poses")


def test_truth_that_lacks_a_cycle_or_is_none(tmp_path, capsys):
    path = write(tmp_path, log_of(range(2)))
    code, out, _ = run(capsys, "--log", path, "--json", "--truth", write(tmp_path, truth_lines([1]), "t.jsonl"))
    assert code == 0
    assert [line["position_error_m"] is None for line in poses(out)] == [True, False]
    for bad in ("{}", "[]", "1", "no json", '{"cycle": 0, "position_m": [1], "orientation_xyzw": [0,0,0,1]}'):
        code, _, err = run(capsys, "--log", path, "--truth", write(tmp_path, f"\n{bad}\n", "t.jsonl"))
        assert code == 2
        assert "t.jsonl:2: is no line of truth" in err
    code, _, err = run(capsys, "--log", path, "--truth", tmp_path / "none")
    assert code == 2
    assert "no such truth file" in err


def pose(epoch, position=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.0, 1.0), status=Status.OK):
    nothing = np.zeros((3, 3))
    return Pose(epoch, 0.1 * epoch, np.array(position), np.array(orientation), nothing, nothing, 1.0, status, ("b1",))


def test_truth_that_is_still_being_written(tmp_path, monkeypatch):
    """A line in two pieces, the second while the reader waits; the cycle's number wraps at 2^20."""
    path = tmp_path / "t.jsonl"
    line = truth_lines([2**20 + 5])
    path.write_text(line[:30])
    sleeps = []

    def sleep(seconds):
        sleeps.append(seconds)
        path.write_text(line)

    monkeypatch.setattr("goldfield.view.truth.time", SimpleNamespace(monotonic=lambda: sum(sleeps), sleep=sleep))
    truth = Truth(path)
    error = truth.error_of(pose(5, np.add(POSITION_M, [0.0, 0.0, 0.01]), ATTITUDE.as_quat()))
    assert len(sleeps) == 1
    assert error.position_m == pytest.approx(0.01)
    assert error.attitude_rad == pytest.approx(0.0, abs=1e-12)
    truth.close()


def test_a_pose_is_compared_at_its_own_time(tmp_path):
    """A sensor that moves along x at 2 m/s while it turns about z, its clock 7 s ahead: known between the rows."""
    course = [[t, 2.0 * t, 0.0, 0.0, 0.0, 0.0, math.sin(t), math.cos(t)] for t in np.linspace(0.3, 0.4, 5).tolist()]
    line = {"cycle": 3, "t_s": 0.35, "position_m": [0.7, 0, 0], "orientation_xyzw": [0, 0, math.sin(0.35), 0.939373]}
    truth = Truth(write(tmp_path, json.dumps(line | {"course": course}) + "\n", "t.jsonl"))
    orientation = [0.0, 0.0, math.sin(0.39), math.cos(0.39)]
    late = replace(pose(3, [0.78, 0.0, 0.01], orientation), time_s=7.39)
    assert truth.error_of(late).position_m == pytest.approx(math.hypot(0.08, 0.01)), "of the middle, without a clock"
    truth.follow(3, math.nan)
    truth.follow(3, 7.35)
    error = truth.error_of(late)
    assert error.position_m == pytest.approx(0.01, abs=1e-9)
    assert error.attitude_rad < 1e-4
    middle = replace(pose(3, [0.7, 0.0, 0.0], line["orientation_xyzw"]), time_s=7.35)
    assert truth.error_of(middle).position_m == 0.0
    truth.close()


@pytest.mark.parametrize("course", [[[0.0] * 8], [[0.1, *[0.0] * 7], [0.1, *[0.0] * 7]], [[0.0] * 7] * 2])
def test_a_course_that_is_none_is_refused(tmp_path, course):
    record = json.loads(truth_lines([3])) | {"course": course}
    truth = Truth(write(tmp_path, json.dumps(record) + "\n", "t.jsonl"))
    with pytest.raises(UserError, match=r"t\.jsonl:1: is no line of truth"):
        truth.error_of(pose(3, POSITION_M, ATTITUDE.as_quat()))
    truth.close()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, math.pi])
def test_rotation_angle(angle):
    first = Rotation.from_rotvec([0.3, -2.0, 0.7])
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    second = Rotation.from_rotvec(angle * axis) * first
    assert rotation_angle(first.as_quat(), -second.as_quat()) == pytest.approx(angle, rel=1e-6, abs=1e-15)


def test_a_full_disk_does_not_stop_the_run(tmp_path, capsys):
    code, out, err = run(capsys, "--log", write(tmp_path, log_of(range(2))), "--json", "--record", "/dev/full")
    assert code == 3
    assert len(poses(out)) == 2
    assert "recording stopped after 0 bytes: No space left on device; the run goes on" in err


def test_as_a_program(tmp_path):
    path = write(tmp_path, log_of(range(2)))
    command = [sys.executable, "-m", "goldfield", "run", "--log", str(path), "--site", str(SITE), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert len(poses(done.stdout)) == 2


def test_the_sensors_fields_are_those_of_magpylib():
    """Guards the fake sensor: strong, all different, and none out of a message's range."""
    sizes = np.linalg.norm(beacon_fields(), axis=1)
    assert (sizes > 1e-7).all()
    assert (sizes < 52e-6).all()


@pytest.mark.parametrize("limit", ["0", "-1", "nan", "x", "inf"])
def test_an_alert_limit_that_is_no_length_is_refused(capsys, limit):
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--alert-limit", limit])
    assert f"{limit} is no length in metres greater than zero" in capsys.readouterr().err


@pytest.mark.parametrize(("share", "status"), [(1.01, "ok"), (0.99, "unverified")])
def test_both_sides_of_the_alert_limit_of_the_command_line(tmp_path, capsys, share, status):
    path = write(tmp_path, log_of(range(1)))
    (pose_,) = poses(run(capsys, "--log", path, "--json")[1])
    (again,) = poses(run(capsys, "--log", path, "--json", "--alert-limit", share * pose_["protection_m"])[1])
    assert again["status"] == status
    assert (again["reason"] is None) == (status == "ok")


def test_lines_that_are_late_are_told_of_once_and_measured(capsys, monkeypatch):
    from goldfield.cli import pose_lines
    from goldfield.sensor.pipeline import Fix
    from goldfield.view.summary import Summary

    now = [100.0]
    clocks = SimpleNamespace(time=lambda: now[0], process_time=lambda: 7.0)
    monkeypatch.setattr(pose_lines, "time", clocks)
    summary = Summary("poses")
    lines = pose_lines.PoseLines(pose_lines.json_record_line(truth=False), summary, None, live=True)
    for late_s in (0.004, 0.9, 1.5, 2.0):
        lines.write(Fix(pose(3, POSITION_M, ATTITUDE.as_quat()), now[0] - late_s, 7.0 - 0.1 * late_s))
    lines.write(Fix(pose(3, POSITION_M, ATTITUDE.as_quat()), math.nan))
    lines.close()
    captured = capsys.readouterr()
    assert len(poses(captured.out)) == 5
    assert captured.err.count("the lines are more than 1 s late") == 1
    assert summary.latency.count == 4
    assert summary.latency.late.quantiles()["median"] == pytest.approx(0.9, rel=0.02)
    assert "5 poses: 5 ok" in summary.text(truth=False)
    told = summary.record()["latency"]
    assert [told["p99_s"], told["most_s"]] == [pytest.approx(2.0, rel=0.02), 2.0]
    assert told["work"]["median_s"] == pytest.approx(0.09, rel=0.02)
    assert told["work"]["most_s"] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--alert-limit", "1e9"], "argument --alert-limit: 1e9 is too large: give less than 1e+09"),
        (["--seconds", "1e12"], "argument --seconds: 1e12 is too large: give less than 1e+09"),
        (["--rate", "1e9"], "--rate: 1e+09 Hz is not above 0 and at most 10000 Hz"),
        (["--rate", "10001"], "--rate: 10001 Hz is not above 0 and at most 10000 Hz"),
        (["--lag", "5000"], "--lag: 5 s is not above 0 and at most 2 s"),
    ],
)
def test_what_is_too_large_is_not_called_too_small_and_has_its_unit(capsys, tmp_path, words, said):
    log = write(tmp_path, log_of(range(2)))
    with contextlib.suppress(SystemExit):
        assert main(["run", "--log", str(log), "--site", str(SITE), *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--rate", "10000"], ["--lag", "2000"]])
def test_the_largest_rate_and_lag_are_taken(tmp_path, words):
    log = write(tmp_path, log_of(range(2)))
    assert main(["run", "--log", str(log), "--site", str(SITE), *words]) == 0

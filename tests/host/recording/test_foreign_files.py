"""Runs that other programs wrote, that were cut off, or that come through a pipe."""

import io
import json
import os
import sys
import threading

import pytest
from mcap.writer import Writer

from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.recording.line_checks import check_fields, check_line
from goldfield.recording.runs import McapRun
from tests.host.fake_sensor import SITE, heartbeat, log_of

CYCLES = 6
FIELD = {"beacon": "b1", "b_T": [1e-7, None, 0.0], "sigma_T": 1e-9}
CYCLE = {"epoch": 3, "t_s": 0.3, "unix_s": None, "fields": [FIELD]}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A run in each form in which it may be kept: messages, poses, and both."""
    folder = tmp_path_factory.mktemp("kept")
    log, mcap, lines = folder / "a.log", folder / "a.mcap", folder / "a.jsonl"
    log.write_text(log_of(range(CYCLES), [heartbeat()]))
    run = ["run", "--log", str(log), "--site", str(SITE), "--json", "--record", str(mcap), "--summary", os.devnull]
    with pytest.MonkeyPatch.context() as patch, lines.open("w") as out:
        patch.setattr(sys, "stdout", out)
        assert main(run) == 0
    return {"log": log, "mcap": mcap, "jsonl": lines}


@pytest.fixture
def line(kept):
    return json.loads(kept["jsonl"].read_text().splitlines()[2])


def test_what_goldfield_writes_is_right(kept):
    for text in kept["jsonl"].read_text().splitlines():
        check_line(json.loads(text))
    assert sum(1 for _ in McapRun(kept["mcap"])) == 2 * CYCLES  # poses and fields
    check_fields(CYCLE)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"position_m": [1.0, None, "a"]}, "position_m is not 3 numbers"),
        ({"position_m": [1.0, 2.0]}, "position_m is not 3 numbers"),
        ({"position_m": [1e400, 0.0, 0.0]}, "position_m is not 3 numbers"),
        ({"position_m": [10**400, 0, 0]}, "position_m is not 3 numbers"),
        ({"position_m": None}, "one of position_m and orientation_xyzw is null"),
        ({"orientation_xyzw": [0, 0, 0, 0]}, "orientation_xyzw is 0"),
        ({"position_cov_m2": [[1.0, 0.0, 0.0]] * 2}, "position_cov_m2 is not 3 times 3 numbers"),
        ({"epoch": "7"}, "epoch is not a whole number"),
        ({"epoch": None}, "epoch is not a whole number"),
        ({"t_s": "now"}, "t_s is not a number"),
        ({"residual": [1.0]}, "residual is not a number"),
        ({"status": "fine"}, "status is none of ambiguous, failed, inconsistent, ok, unverified, weak"),
        ({"status": ["ok"]}, "status is none of"),
        ({"reason": 7}, "reason is not text"),
        ({"used": [1, 2]}, "used is not text"),
        ({"beacons": ["b1"]}, "beacons is not a number for each id"),
        ({"beacons": {"b1": "large"}}, "beacons is not a number for each id"),
    ],
)
def test_a_line_with_a_value_of_another_kind_is_refused_by_each_command(line, tmp_path, capsys, change, said):
    path = tmp_path / "a.jsonl"
    path.write_text(f"{json.dumps(line)}\n{json.dumps(line | change)}\n{json.dumps(line)}\n")
    for command in (
        ["export", str(path), "--to", "csv", "--out", "-"],
        ["plot", str(path), "--out", str(tmp_path / "a.png")],
        ["compare-runs", str(path), str(path)],
    ):
        assert main(command) == 2
        assert f"{path}:2: is no line of goldfield run --json: {said}" in capsys.readouterr().err


@pytest.mark.parametrize("record", [None, 7, [CYCLE], {"epoch": 1}])
def test_what_is_no_record_lacks_its_keys(record):
    for check in (check_line, check_fields):
        with pytest.raises(ValueError, match="keys are missing"):
            check(record)


@pytest.mark.parametrize(
    "change",
    [
        {"fields": {}},
        {"fields": [None]},
        {"fields": [FIELD | {"beacon": 1}]},
        {"fields": [FIELD | {"b_T": [0.0, 0.0]}]},
        {"fields": [FIELD | {"b_T": 0.0}]},
        {"fields": [FIELD | {"sigma_T": "small"}]},
        {"epoch": 1.5},
        {"t_s": "x"},
    ],
)
def test_fields_of_another_kind_are_refused(change):
    with pytest.raises(ValueError, match="is not"):
        check_fields(CYCLE | change)


@pytest.mark.parametrize("topic", ["/goldfield/line", "/goldfield/fields"])
def test_a_message_of_another_program_is_refused_and_not_called_damage(tmp_path, topic):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic=topic, message_encoding="json", schema_id=0)
        writer.add_message(channel, log_time=0, publish_time=0, data=b'{"epoch": 1}')
        writer.finish()
    with pytest.raises(UserError, match=f"a message of {topic} is not as goldfield run writes it: keys are missing"):
        list(McapRun(path))


def test_a_last_line_that_is_cut_off_costs_this_line_alone(kept, tmp_path, capsys):
    """As of a program that was killed, or of a disk that was full; a line amid the others is an error still."""
    whole = kept["jsonl"].read_bytes()
    path = tmp_path / "a.jsonl"
    path.write_bytes(whole[:-40])
    assert main(["compare-runs", str(path), str(kept["mcap"])]) == 0
    said = capsys.readouterr()
    assert f"bit-identical: all {CYCLES - 1} poses that both have" in said.out
    assert f"{path}:{CYCLES}: the last line is cut off: what comes before is used" in said.err
    path.write_bytes(whole[:-40] + b"\n" + whole)
    assert main(["compare-runs", str(path), str(kept["mcap"])]) == 2
    path.write_bytes(whole[:40])
    assert main(["compare-runs", str(path), str(kept["mcap"])]) == 2
    assert "is no line of goldfield run --json" in capsys.readouterr().err


def through_stdin(data, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BufferedReader(io.BytesIO(data))))
    return "-"


def through_a_named_pipe(data, monkeypatch, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    threading.Thread(target=pipe.write_bytes, args=(data,), daemon=True).start()
    return str(pipe)


@pytest.mark.parametrize("way", [through_stdin, through_a_named_pipe])
@pytest.mark.parametrize("form", ["log", "mcap", "jsonl"])
def test_a_run_may_come_through_a_pipe(kept, tmp_path, capsys, monkeypatch, form, way):
    with_site = ["--site", str(SITE)] if form == "log" else []
    assert main(["export", str(kept[form]), *with_site, "--to", "csv", "--out", "-"]) == 0
    from_file = capsys.readouterr().out
    path = way(kept[form].read_bytes(), monkeypatch, tmp_path)
    assert main(["export", path, *with_site, "--to", "csv", "--out", "-"]) == 0
    assert capsys.readouterr().out == from_file
    assert from_file.count("\n") == 1 + CYCLES


@pytest.mark.parametrize("way", [through_stdin, through_a_named_pipe])
@pytest.mark.parametrize("command", [["compare-runs"], ["export", "--again", "--to", "csv", "--out", "-"]])
def test_what_is_read_twice_cannot_come_through_a_pipe(kept, tmp_path, capsys, monkeypatch, command, way):
    path = way(kept["mcap"].read_bytes(), monkeypatch, tmp_path)
    assert main([*command, path]) == 2
    assert "is read twice to make its poses again: save it as a file first" in capsys.readouterr().err


def test_messages_alone_are_compared_with_a_second_run_only(kept, capsys):
    """With what is made of themselves they would agree whatever the estimator does."""
    log, mcap = str(kept["log"]), str(kept["mcap"])
    assert main(["compare-runs", log, "--site", str(SITE)]) == 2
    said = capsys.readouterr().err
    assert f"{log}: holds messages and no poses to compare with today's: give a second run" in said
    assert main(["compare-runs", str(kept["jsonl"])]) == 2
    assert "holds poses and no messages: nothing can be made of it again" in capsys.readouterr().err
    assert main(["compare-runs", log, mcap, "--site", str(SITE)]) == 0

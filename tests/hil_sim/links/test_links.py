"""The bench's serial ports, and the command that serves its links."""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import goldfield
from goldfield.errors import UserError
from hil_sim import command
from hil_sim.clib import ROOT
from hil_sim.links import serve
from hil_sim.links.port_name import PortName
from hil_sim.links.pseudo_terminal import WAITING_LIMIT, PseudoTerminal
from hil_sim.links.read_command import read_command
from hil_sim.links.readers import LISTENER_S
from tests.hil_sim.rig.fakes import FakeBoards, write_scenario

EVERY_BYTE = bytes(range(256))


@pytest.fixture
def terminal():
    made = PseudoTerminal()
    yield made
    made.close()


def read_exactly(descriptor, count):
    data = b""
    while len(data) < count:
        data += os.read(descriptor, count - len(data))
    return data


def test_every_byte_passes_unchanged_both_ways(terminal):
    other = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY)
    terminal.write(EVERY_BYTE, wait=False)
    assert read_exactly(other, 256) == EVERY_BYTE
    os.write(other, EVERY_BYTE)
    back = b""
    while len(back) < 256:
        back += terminal.read()
    assert back == EVERY_BYTE
    os.close(other)


def test_nobody_listens_then_somebody_does(terminal):
    assert not terminal.opened
    terminal.write(b"unheard", wait=True)
    for _ in range(2):
        other = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY)
        assert terminal.opened
        terminal.write(b"\x0d\x0a\x03heard", wait=True)
        assert read_exactly(other, 8) == b"\x0d\x0a\x03heard"
        os.close(other)
        assert not terminal.opened
    assert terminal.read() == b""


def test_a_slow_reader_loses_nothing_if_the_bench_waits(terminal):
    data = np.random.default_rng(1).bytes(300_000)
    other = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY)
    got = []
    reader = threading.Thread(target=lambda: got.append(read_exactly(other, len(data))))
    reader.start()
    for start in range(0, len(data), 5000):
        terminal.write(data[start : start + 5000], wait=True)
    reader.join()
    assert got == [data]
    assert terminal.lost == 0
    os.close(other)


def test_a_reader_that_does_not_read_costs_counted_bytes_if_the_bench_does_not_wait(terminal):
    other = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY)
    data = np.random.default_rng(2).bytes(8 * WAITING_LIMIT)
    for start in range(0, len(data), 4096):
        terminal.write(data[start : start + 4096], wait=False)
    assert terminal.lost > 0
    kept = len(data) - terminal.lost
    got = b""
    while len(got) < kept:
        terminal.write(b"", wait=False)
        got += read_exactly(other, min(4096, kept - len(got)))
    assert got[-WAITING_LIMIT:] == data[-WAITING_LIMIT:]
    os.close(other)


def test_a_reader_that_leaves_while_the_bench_waits_does_not_hold_it(terminal):
    other = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY)

    def read_a_little_and_leave():
        read_exactly(other, 10_000)
        os.close(other)

    reader = threading.Thread(target=read_a_little_and_leave)
    reader.start()
    terminal.write(bytes(10**6), wait=True)
    reader.join()
    assert not terminal.opened


# ---- Its name ----


def test_a_name_leads_to_the_port_and_goes_with_it(tmp_path, terminal):
    name = PortName(tmp_path / "port", terminal.path)
    other = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY)
    terminal.write(b"heard", wait=True)
    assert read_exactly(other, 5) == b"heard"
    os.close(other)
    name.close()
    assert not (tmp_path / "port").is_symlink()


@pytest.mark.parametrize("left", ["/dev/pts/999999999", "own"])
def test_what_a_killed_bench_left_is_replaced(tmp_path, terminal, left):
    """Its terminal is gone, or its number was given to this bench."""
    (tmp_path / "port").symlink_to(terminal.path if left == "own" else left)
    name = PortName(tmp_path / "port", terminal.path)
    assert str((tmp_path / "port").readlink()) == terminal.path
    name.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("target", ["/dev/null", "nowhere", "/dev/pts/999999999x", "the port of a living bench"])
def test_no_other_link_is_replaced(tmp_path, terminal, target):
    living, path = PseudoTerminal(), tmp_path / "port"
    path.symlink_to(living.path if " " in target else target)
    before = path.readlink()
    with pytest.raises(UserError, match=rf"^--link {path}: there is a link of this name to {before} already: give an"):
        PortName(path, terminal.path)
    assert path.readlink() == before
    living.close()


def test_no_file_or_folder_is_replaced(tmp_path, terminal):
    (tmp_path / "file").write_text("precious")
    for path in (tmp_path, tmp_path / "file"):
        with pytest.raises(UserError, match=rf"^--link {path}: there is something of this name already: give another"):
            PortName(path, terminal.path)
    assert (tmp_path / "file").read_text() == "precious"


def test_a_name_that_is_another_benchs_by_now_stays(tmp_path, terminal):
    path = tmp_path / "port"
    name = PortName(path, terminal.path)
    path.unlink()
    path.symlink_to("/dev/pts/999999999")
    name.close()
    assert path.is_symlink()
    path.unlink()
    name.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_the_name_goes_however_the_bench_ends(tmp_path, number):
    name = tmp_path / "port"
    words = ["prigge8", "--boards", "host", "--link", str(name)]
    with subprocess.Popen(
        [sys.executable, "-m", "hil_sim.command", *words], stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as bench:
        first = bench.stdout.readline()
        assert first.startswith(f"serial {name}, CAN none (prigge8")
        assert name.is_symlink()
        bench.stdout.readline()
        bench.send_signal(number)
        rest = bench.stdout.read()
    assert bench.returncode == 0
    assert "virtual seconds in" in rest
    assert not name.is_symlink()


# ---- The command ----


def hil(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "hil_sim.command", *arguments], capture_output=True, text=True, cwd=ROOT
    )


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["atlantis"], "there is no scenario 'atlantis'"),
        (["prigge8", "--can", "can0"], "--can can0: is no CAN channel: write own, INTERFACE:CHANNEL or none"),
        (["prigge8", "--link", "/no/such/port"], "--link /no/such/port: cannot be made: No such file or directory"),
        (["prigge8", "--truth", "a", "--link", "a"], "is the file of --truth and would be overwritten by --link"),
        (["prigge8", "--boards", "wood"], "invalid choice: 'wood'"),
        (
            ["prigge8", "--can", "none", "--boards", "host", "--truth", "/no/such/t"],
            "/no/such/t: the truth cannot be written",
        ),
    ],
)
def test_bad_usage_ends_with_2_and_a_sentence(arguments, sentence):
    result = hil(*arguments)
    assert result.returncode == 2
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr


def run_command(tmp_path, monkeypatch, capsys, *options, boards=None, scenario=None, can=("--can", "none")):
    """The command in this process, on fake boards."""
    monkeypatch.setattr("hil_sim.rig.rig.factory", lambda kind, cycles: boards or FakeBoards())
    path = scenario or write_scenario(tmp_path)
    code = command.main([str(path), *can, "--pace", "0", *options])
    return code, capsys.readouterr()


def test_json_lines(tmp_path, monkeypatch, capsys):
    code, output = run_command(tmp_path, monkeypatch, capsys, "--json", "--seconds", "0.0501")
    first, *lines = map(json.loads, output.out.splitlines())
    assert code == 0
    assert first.keys() == {"serial", "can", "scenario", "boards", "read"}
    assert first["serial"].startswith("/dev/")
    assert [line["cycle"] for line in lines] == list(range(len(lines)))
    assert len(lines) == 16  # 31 chips of 97.75 us each
    assert lines[0].keys() == {"cycle", "t_s", "position_m", "orientation_xyzw"}
    assert "0.050 virtual seconds in" in output.err


ANCHORED = "[beacon.sensor]\nposition_m = [0.0, 0.0, 0.7]\n\n[[beacon]]"


def test_every_anchors_serial_port_is_told(tmp_path, monkeypatch, capsys):
    path = write_scenario(tmp_path)
    first, one, two, three = path.read_text().split("[[beacon]]")
    path.write_text(f"{first}[[beacon]]{one}[[beacon]]{two}{ANCHORED}{three}")
    options = {"scenario": path}
    _, output = run_command(tmp_path, monkeypatch, capsys, "--json", "--seconds", "0.01", **options)
    told = json.loads(output.out.splitlines()[0])
    assert told["anchors"].keys() == {"b"}
    assert told["anchors"]["b"]["node"] == 2
    _, output = run_command(tmp_path, monkeypatch, capsys, "--seconds", "0.01", **options)
    sensor, anchor = output.out.splitlines()[:2]
    assert sensor.startswith("serial /dev/")
    assert anchor.startswith("serial /dev/")
    assert anchor.endswith("anchor b, node 2")
    assert anchor.split()[1] != sensor.split()[1]
    name = tmp_path / "port"
    _, output = run_command(tmp_path, monkeypatch, capsys, "--seconds", "0.01", "--link", str(name), **options)
    assert [line.split()[1].rstrip(",:") for line in output.out.splitlines()[:2]] == [str(name), f"{name}.2"]
    assert list(tmp_path.iterdir()) == [path]


def test_truth_goes_to_a_file_and_only_there(tmp_path, monkeypatch, capsys):
    truth = tmp_path / "truth.jsonl"
    code, output = run_command(tmp_path, monkeypatch, capsys, "--json", "--seconds", "0.05", "--truth", str(truth))
    assert code == 0
    assert len(output.out.splitlines()) == 1
    assert len(truth.read_text().splitlines()) == 16


def test_a_failing_board_ends_with_3(tmp_path, monkeypatch, capsys):
    code, output = run_command(tmp_path, monkeypatch, capsys, boards=FakeBoards(stops={0: 10**10}))
    assert code == 3
    assert "goldfield: the sensor stopped at 0.0" in output.err
    assert "asked to stop" in output.err


OUTSIDE = [
    *(("--seed", seed, "is no seed: seeds are 0 to 2^63 - 1") for seed in ("-1", str(1 << 63), "9" * 5000, "x", "1.5")),
    *(("--pace", pace, "is no pace") for pace in ("-1", "1e-300", "9.99e-4", "1000001", "inf", "nan", "x", "")),
    *(("--seconds", seconds, "is no number of") for seconds in ("-1", "0", "1e-300", "9e-4", "5000001", "nan", "inf")),
]
INSIDE = [("--pace", "0"), ("--pace", "0.001"), ("--pace", "1e6"), ("--seconds", "0.001"), ("--seconds", "5e6")]


@pytest.mark.parametrize(("option", "value", "sentence"), OUTSIDE, ids=lambda text: text[:12])
def test_a_value_that_no_bench_has_is_refused(capsys, option, value, sentence):
    with pytest.raises(SystemExit) as ended:
        command.main(["prigge8", option, value])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert f"argument {option}: '{value[:100]}" in said
    assert f"' {sentence}" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(("option", "value"), INSIDE)
def test_a_value_at_the_limit_is_taken(option, value):
    parser = argparse.ArgumentParser()
    command.command(parser.add_subparsers())
    arguments = parser.parse_args(["hil", "prigge8", option, value])
    assert getattr(arguments, option.removeprefix("--")) == float(value)


def test_it_is_a_subcommand():
    parser = argparse.ArgumentParser()
    command.command(parser.add_subparsers())
    arguments = parser.parse_args(["hil", "prigge8", "--seconds", "3", "--seed", str((1 << 63) - 1)])
    assert arguments.seed == (1 << 63) - 1
    assert arguments.run is command.run
    assert (arguments.pace, arguments.boards, arguments.can) == (1.0, "emulated", "none")


def test_the_channel_is_told_and_no_bench_has_one_unasked(tmp_path, monkeypatch, capsys):
    _, output = run_command(tmp_path, monkeypatch, capsys, "--json", "--seconds", "0.01", can=())
    assert json.loads(output.out.splitlines()[0])["can"] == "none"
    _, output = run_command(tmp_path, monkeypatch, capsys, "--json", "--seconds", "0.01", can=("--can", "own"))
    assert re.fullmatch(r"goldfield_loopback:239\.74\.\d+\.\d+:\d+", json.loads(output.out.splitlines()[0])["can"])
    assert "; CAN: 0 frames from outside, 0 refused\n" in output.err


def test_the_commands_that_read_it_are_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = ("--site", "a site.toml", "--link", "a port")
    _, output = run_command(tmp_path, monkeypatch, capsys, "--seconds", "0.01", *names, can=("--can", "own"))
    serial, poses, by_can, *_ = output.out.splitlines()
    channel = re.match(r"serial a port, CAN (goldfield_loopback:\S+) \(", serial)[1]
    _, *words = shlex.split(poses.removeprefix("poses: "))
    assert words == ["run", "--port", f"{tmp_path}/a port", "--site", f"{tmp_path}/a site.toml"]
    _, *words = shlex.split(by_can.removeprefix("by CAN: "))
    assert words == ["run", "--can", channel, "--site", f"{tmp_path}/a site.toml"]


def test_a_host_is_told_the_rates_of_slower_links(tmp_path, monkeypatch, capsys):
    path = write_scenario(tmp_path)
    path.write_text(path.read_text() + "\n[links]\ncan_bit_s = 125000\nserial_baud = 115200\n")
    options = ("--seconds", "0.01", "--link", str(tmp_path / "port"))
    _, output = run_command(tmp_path, monkeypatch, capsys, *options, scenario=path, can=("--can", "own"))
    _, poses, by_can, *_ = output.out.splitlines()
    assert "--bit-rate 115200 " in poses
    assert "--bit-rate 125000 " in by_can


def test_the_program_is_named_so_that_a_shell_finds_it(tmp_path, monkeypatch):
    mine = Path(sys.executable).with_name("goldfield")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert read_command(site=Path("/s")) == f"{mine} run --site /s"
    (tmp_path / "goldfield").write_text("another")
    (tmp_path / "goldfield").chmod(0o755)
    assert read_command(site=Path("/s")) == f"{mine} run --site /s"
    monkeypatch.setenv("PATH", str(mine.parent))
    assert read_command(site=Path("/s")) == "goldfield run --site /s"
    monkeypatch.setattr(sys, "executable", str(tmp_path / "bin" / "python"))
    assert read_command(site=Path("/s")) == f"{tmp_path}/bin/python -m goldfield run --site /s"


def test_a_bench_without_a_site_option_has_a_site_file_while_it_runs(tmp_path, monkeypatch, capsys):
    told = {}

    def look(*_):
        path = shlex.split(capsys.readouterr().out.splitlines()[1])[-1]
        told[path] = goldfield.load_site(path)

    monkeypatch.setattr(serve, "_serve", look)
    run_command(tmp_path, monkeypatch, capsys)
    ((path, site),) = told.items()
    assert site.name == "small"
    assert not Path(path).parent.exists()


def test_pace_never_runs_ahead(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(serve.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(serve.time, "sleep", lambda seconds: clock.__setitem__(0, clock[0] + seconds))
    pace = serve.Pace(2.0)
    for slice_number in range(1, 101):
        pace.wait(0.01 * slice_number)
        assert pace.elapsed_s >= 0.01 * slice_number / 2.0 - 1e-9
    assert pace.elapsed_s == pytest.approx(0.5)
    clock[0] += 10.0  # late: no sleep to make up for
    pace.wait(1.1)
    assert pace.elapsed_s == pytest.approx(10.5)


def test_a_pause_is_not_caught_up(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(serve.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(serve.time, "sleep", lambda seconds: clock.__setitem__(0, clock[0] + seconds))
    pace = serve.Pace(1.0)
    pace.wait(2.0)
    pace.pause_until(lambda: clock[0] > 160.0)
    assert clock[0] > 160.0
    assert pace.elapsed_s == pytest.approx(2.0)
    pace.wait(2.5)
    assert pace.elapsed_s == pytest.approx(2.5)


@pytest.mark.parametrize("sends", [True, False])
def test_a_bench_that_waits_starts_its_boards_and_stands_still_until_it_is_read(tmp_path, monkeypatch, capsys, sends):
    """Who opens a port is not ready yet: its first byte says so, or else that it has been there for a while."""
    truth, port = tmp_path / "truth.jsonl", tmp_path / "port"
    clock, cycles, others = [100.0], [], []

    def sleep(seconds):
        clock[0] += seconds
        cycles.append(len(truth.read_text().splitlines()))
        if len(cycles) == 5:
            others.append(os.open(port, os.O_RDWR | os.O_NOCTTY))
        if len(cycles) == 10 and sends:
            os.write(others[0], b"\0")

    def monotonic():
        clock[0] += 1e-6
        return clock[0]

    monkeypatch.setattr(serve.time, "monotonic", monotonic)
    monkeypatch.setattr(serve.time, "sleep", sleep)
    monkeypatch.setattr(serve, "STARTED_S", 0.02)
    options = ("--json", "--seconds", "0.05", "--truth", str(truth), "--link", str(port), "--wait")
    code, _ = run_command(tmp_path, monkeypatch, capsys, *options)
    assert code == 0
    assert set(cycles) == {6}  # of 31 chips of 97.75 us each, in 0.02 s
    assert len(cycles) == 10 if sends else len(cycles) >= 5 + LISTENER_S / serve.OPENING_S
    assert len(truth.read_text().splitlines()) == 16
    os.close(others.pop())

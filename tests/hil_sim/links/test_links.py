"""The bench's links to other processes: pseudo-terminal, CAN bus, and the command that serves them."""

from __future__ import annotations

import argparse
import json
import os
import select
import subprocess
import sys
import threading

import can
import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.link.can_channel import open_channel
from hil_sim import command
from hil_sim.clib import ROOT
from hil_sim.links.can_bridge import CanBridge, own_channel
from hil_sim.links.pseudo_terminal import WAITING_LIMIT, PseudoTerminal
from hil_sim.rig import Frame, Rig
from tests.hil_sim.rig.fakes import FakeBoards, small, write_scenario

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


def group(number):
    """Return a multicast group of this process: several test runs of one machine must not hear each other."""
    return f"239.{192 + number}.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"


GROUP = group(0)
CHANNEL = f"udp_multicast:{GROUP}"


def test_two_benches_with_groups_of_their_own_do_not_hear_each_other():
    """By itself Linux gives every bus the messages of all groups that the machine's programs have joined."""
    here, there = CanBridge(CHANNEL), CanBridge(f"udp_multicast:{group(1)}")
    host_here, host_there = open_channel("udp_multicast", GROUP), open_channel("udp_multicast", group(1))
    there.to_host([Frame(0.1, 1, 0x21, b"there")])
    here.to_host([Frame(0.1, 1, 0x11, b"here")])
    for bus, mine in ((host_here, 0x11), (host_there, 0x21), (here._bus, 0x11), (there._bus, 0x21)):
        assert bus.recv().arbitration_id == mine
        assert bus.recv(0.0) is None
    for bus in (here._bus, there._bus, host_here, host_there):
        bus.shutdown()


def test_can_round_trip_over_multicast(tmp_path):
    bridge = CanBridge(CHANNEL)
    with (
        open_channel("udp_multicast", GROUP) as other,
        Rig(small(tmp_path), FakeBoards()) as rig,
    ):
        rig.advance(0.02)
        frames = rig.can_read()
        bridge.to_host(frames)
        for frame in frames:
            message = other.recv()
            assert message is not None
            assert (message.arbitration_id, bytes(message.data)) == (frame.identifier, frame.data)
            assert message.is_extended_id
        other.send(can.Message(arbitration_id=0x0C064001, data=b"\x12\x34", is_extended_id=True))
        mine = []
        while not mine:
            select.select([bridge._bus.fileno()], [], [])
            bridge.to_boards(rig)
            rig.advance(0.001)
            mine = [frame for frame in rig.can_read() if frame.board == 4]
        # Its own frames came back to the bridge before this one, and went no further.
        assert [(frame.identifier, frame.data) for frame in mine] == [(0x0C064001, b"\x12\x34")]
    bridge.close()


def test_frames_that_nobody_acknowledged_stay_on_the_bench():
    bridge = CanBridge(CHANNEL)
    with open_channel("udp_multicast", GROUP) as other:
        bridge.to_host([Frame(0.1, 1, 0x10, b"", acknowledged=False), Frame(0.2, 1, 0x11, b"x")])
        assert other.recv().arbitration_id == 0x11
    bridge.close()


@pytest.mark.parametrize("channel", ["vcan0", "socketcan:", ":can0", "no_such_interface:0"])
def test_a_wrong_channel_is_an_error(channel):
    with pytest.raises(UserError, match=r"CAN channel"):
        CanBridge(channel)


# ---- The command ----


def hil(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "hil_sim.command", *arguments], capture_output=True, text=True, cwd=ROOT
    )


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["atlantis"], "there is no scenario 'atlantis'"),
        (["prigge8", "--can", "can0"], "'can0' is no CAN channel"),
        (["prigge8", "--seconds", "-1"], "--seconds: '-1' is no number from zero up"),
        (["prigge8", "--boards", "wood"], "invalid choice: 'wood'"),
        (
            ["prigge8", "--can", "none", "--boards", "host", "--truth", "/no/such/t"],
            "cannot write the truth to /no/such/t",
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
    monkeypatch.setattr("hil_sim.rig.rig.factory", lambda kind: boards or FakeBoards())
    path = scenario or write_scenario(tmp_path)
    code = command.main([str(path), *can, "--pace", "0", *options])
    return code, capsys.readouterr()


def test_json_lines(tmp_path, monkeypatch, capsys):
    code, output = run_command(tmp_path, monkeypatch, capsys, "--json", "--seconds", "0.0501")
    first, *lines = map(json.loads, output.out.splitlines())
    assert code == 0
    assert first.keys() == {"serial", "can", "scenario", "boards"}
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


@pytest.mark.parametrize("seed", ["-1", str(1 << 63), "9" * 5000, "x", "1.5"])
def test_a_seed_that_no_rig_has_is_refused(capsys, seed):
    with pytest.raises(SystemExit) as ended:
        command.main(["prigge8", f"--seed={seed}"])
    assert ended.value.code == 2
    assert "is no seed: seeds are 0 to 2^63 - 1" in capsys.readouterr().err


def test_it_is_a_subcommand():
    parser = argparse.ArgumentParser()
    command.command(parser.add_subparsers())
    arguments = parser.parse_args(["hil", "prigge8", "--seconds", "3", "--seed", str((1 << 63) - 1)])
    assert arguments.seed == (1 << 63) - 1
    assert arguments.run is command.run
    assert (arguments.pace, arguments.boards, arguments.can) == (1.0, "emulated", None)


def test_benches_of_one_machine_have_a_can_channel_each(monkeypatch):
    monkeypatch.setattr("hil_sim.links.can_bridge.DEFAULT", f"test{os.getpid()}:239.74.163.2")
    (one, first), (two, second) = own_channel(), own_channel()
    assert (one, two) == (f"test{os.getpid()}:239.74.163.2", f"test{os.getpid()}:239.74.163.3")
    first.close()
    again, third = own_channel()
    assert again == one
    second.close()
    third.close()


def test_no_channel_is_left(monkeypatch):
    monkeypatch.setattr("hil_sim.links.can_bridge.MOST_BENCHES", 0)
    with pytest.raises(UserError, match=r"^0 benches run on this machine, each with its CAN channel: --can none"):
        own_channel()


def test_the_default_channel_is_told(tmp_path, monkeypatch, capsys):
    taken = []
    monkeypatch.setattr(command, "CanBridge", lambda channel: taken.append(CanBridge(channel)) or taken[-1])
    _, output = run_command(tmp_path, monkeypatch, capsys, "--json", "--seconds", "0.01", can=())
    assert json.loads(output.out.splitlines()[0])["can"] == taken[0].channel


def test_pace_never_runs_ahead(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(command.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(command.time, "sleep", lambda seconds: clock.__setitem__(0, clock[0] + seconds))
    pace = command.Pace(2.0)
    for slice_number in range(1, 101):
        pace.wait(0.01 * slice_number)
        assert pace.elapsed_s >= 0.01 * slice_number / 2.0 - 1e-9
    assert pace.elapsed_s == pytest.approx(0.5)
    clock[0] += 10.0  # late: no sleep to make up for
    pace.wait(1.1)
    assert pace.elapsed_s == pytest.approx(10.5)

"""`goldfield run` beside other traffic, other sensors and other programs, and through pauses and pulled cables."""

import fcntl
import itertools
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import tty
from types import SimpleNamespace

import pytest

from goldfield.cli import main
from goldfield.link import buses
from goldfield_protocol import encode_frame
from tests.host.fake_sensor import (
    CODES,
    CYCLE_S,
    NODE,
    SITE,
    TOO_SLOW,
    PtySensor,
    candump,
    cycle_messages,
    heartbeat,
    log_of,
)

J1939 = ["(0.1) can0 08FE6E0B#0102030405060708", "(0.1) can0 0C000003#0055000000FFFFFF", "(0.1) can0 18DAF110#0102"]


def run(capsys, *options):
    code = main(["run", "--site", str(SITE), *map(str, options)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def epochs(out):
    return [json.loads(line)["epoch"] for line in out.splitlines()]


@pytest.fixture
def line():
    """A pseudo-terminal: the board's end, the host's end and its path."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield SimpleNamespace(master=master, slave=slave, path=os.ttyname(slave))
    os.close(master)
    os.close(slave)


def test_foreign_frames_in_a_log_cost_nothing_and_are_counted(tmp_path, capsys):
    lines = log_of(range(3)).splitlines()
    path = tmp_path / "a.log"
    path.write_text("\n".join([*lines[:5], *J1939, *lines[5:]]) + "\n")
    code, out, err = run(capsys, "--log", path, "--json")
    assert (code, epochs(out)) == (0, [0, 1, 2])
    assert "the link: 2 foreign frames, 1 message of a wrong length" in err


@pytest.mark.parametrize(("before", "printed"), [(0, 0), (9, 0), (20, 20)])
def test_a_sensor_with_another_protocol_in_a_log_is_refused(tmp_path, capsys, before, printed):
    """Before any pose, if its heartbeat comes in the first second, as it does on a bus."""
    stranger = candump([((before + 0.5) * CYCLE_S, heartbeat(hash_=1))])
    path = tmp_path / "a.log"
    path.write_text(log_of(range(before)) + stranger + log_of(range(before, before + 2)))
    code, out, err = run(capsys, "--log", path, "--json")
    assert (code, len(out.splitlines())) == (2, printed)
    assert err.endswith(": read the recording with the version of goldfield that made it\n")


def test_two_buses_in_one_log(tmp_path, capsys):
    near, far = (log_of(range(first, first + 3)).splitlines() for first in (0, 40))
    path = tmp_path / "two.log"
    path.write_text("\n".join(b for a in zip(near, far, strict=True) for b in (a[0], a[1].replace("can0", "can1"))))
    code, out, err = run(capsys, "--log", path, "--json")
    assert (code, out) == (2, "")
    assert err == (
        f"goldfield: {path}: there are several sensors: sensor 100 on can0 (--channel can0), sensor 100 on can1 "
        "(--channel can1): choose one\n"
    )
    for channel, first in (("can0", 0), ("can1", 40)):
        code, out, err = run(capsys, "--log", path, "--json", "--channel", channel)
        assert (code, epochs(out)) == (0, list(range(first, first + 3)))
        assert "33 messages of other channels" in err


def test_two_sensors_in_one_log(tmp_path, capsys):
    path = tmp_path / "two.log"
    own = [message for cycle in range(3) for message in cycle_messages(cycle)]
    other = [(identifier & ~0xFFF | 7, data) for cycle in range(50, 53) for identifier, data in cycle_messages(cycle)]
    path.write_text(candump((0.01 * t, m) for t, pair in enumerate(zip(own, other, strict=True)) for m in pair))
    code, _, err = run(capsys, "--log", path)
    assert code == 2
    assert "sensor 7 (--node 7), sensor 100 (--node 100): choose one" in err
    assert epochs(run(capsys, "--log", path, "--json", "--node", 7)[1]) == [50, 51, 52]


@pytest.mark.parametrize("choice", [("--node", 5), ("--channel", "can7")])
def test_a_sensor_that_is_not_in_a_log_and_the_one_that_is(tmp_path, capsys, choice):
    path = tmp_path / "one.log"
    path.write_text(log_of(range(3)))
    code, out, err = run(capsys, "--log", path, *choice)
    assert (code, out) == (2, "")
    assert err == f"goldfield: {path}: holds no cycle of the sensor that was chosen, but of node 100 on can0\n"


def test_seconds_go_on_behind_a_restart_of_the_sensor(tmp_path, capsys):
    """Its clock begins again, at 0 or at any other time that is less."""
    path = tmp_path / "one.log"
    messages = [m for cycle in range(300, 305) for m in cycle_messages(cycle)]
    messages += [m for cycle in range(305, 340) for m in cycle_messages(cycle, time_s=(cycle - 304.5) * CYCLE_S)]
    path.write_text(candump((0.009 * place, message) for place, message in enumerate(messages)))
    code, out, _ = run(capsys, "--log", path, "--json", "--seconds", 2)
    assert (code, epochs(out)) == (0, list(range(300, 320)))


def test_a_quiet_run_keeps_its_summary_off_stderr(tmp_path, capsys):
    path = tmp_path / "one.log"
    path.write_text(log_of(range(3)))
    code, out, err = run(capsys, "--log", path, "--json", "-q")
    assert (code, epochs(out), err) == (0, [0, 1, 2], "")
    assert "3 epochs: 3 ok" in run(capsys, "--log", path, "-q")[1]


def test_a_monitor_chooses_a_channel_too(tmp_path, capsys):
    near, far = (log_of(range(first, first + 3)).splitlines() for first in (0, 40))
    path = tmp_path / "two.log"
    path.write_text("\n".join([*near, *(line.replace("can0", "can1") for line in far)]))
    words = ["monitor", "--log", str(path), "--site", str(SITE), "--json"]
    assert main(words) == 2
    assert "sensor 100 on can1 (--channel can1): choose one" in capsys.readouterr().err
    assert main([*words, "--channel", "can1"]) == 0
    assert json.loads(capsys.readouterr().out)["t_s"] == pytest.approx(42.5 * CYCLE_S)


@pytest.mark.parametrize("command", ["run", "monitor"])
def test_listening_sends_nothing(line, capsys, command):
    """Neither at the start nor later, though the board has a code less in its list, and says that it has started."""
    os.set_blocking(line.master, False)
    stop = threading.Event()

    def play():
        for cycle in itertools.count():
            for message in (heartbeat(state=0), *cycle_messages(cycle, codes=CODES[:7])):
                data = encode_frame(*message)
                while data and not stop.is_set():
                    if select.select([], [line.master], [], 0.02)[1]:
                        data = data[os.write(line.master, data) :]
            if stop.is_set():
                return

    thread = threading.Thread(target=play)
    thread.start()
    words = ["--port", line.path, "--listen-only", "--seconds", "0.3", "--json"]
    code = main([command, "--site", str(SITE), *words])
    stop.set()
    thread.join()
    out, err = capsys.readouterr()
    assert code == 0, err
    assert len(out.splitlines()) >= (3 if command == "run" else 1)
    with pytest.raises(BlockingIOError):
        os.read(line.master, 1)


@pytest.mark.parametrize("command", ["run", "monitor"])
def test_a_pulled_cable_is_waited_for(tmp_path, capsys, monkeypatch, command):
    port = tmp_path / "port"
    with PtySensor(range(3), hang_up=True) as first, PtySensor(range(20, 30)) as second:
        port.symlink_to(first.path)

        def sleep(_):
            port.unlink(missing_ok=True)
            port.symlink_to(second.path)

        monkeypatch.setattr(buses, "time", SimpleNamespace(sleep=sleep, monotonic=lambda: 0.0))
        words = ["--port", str(port), "--reconnect", "--seconds", "2.5", "--json"]
        code = main([command, "--site", str(SITE), *words])
        assert [second.parameters[256 + i] for i in range(8)] == list(CODES), "it is a fresh one"
    out, err = capsys.readouterr()
    assert code == 0
    if command == "run":
        got = epochs(out)
        assert got[0] == 0
        assert got[-5:] == list(range(20, 25))
    else:
        assert json.loads(out.splitlines()[-1])["t_s"] == pytest.approx(24.5 * CYCLE_S)
    assert re.search("the port is gone .*; waiting for it\n.* is back after", err)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_the_usual_end(number):
    with PtySensor(range(1000)) as sensor:
        command = [sys.executable, "-m", "goldfield", "run", "--port", sensor.path, "--site", str(SITE), "--json"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert json.loads(process.stdout.readline())["epoch"] == 0
            process.send_signal(number)
            _, message = process.communicate()
            assert process.returncode == 0, message
    times = r"median \S+ ms, 95 % within \S+ ms, 99 % within \S+ ms"
    late = rf"from the last message to the line: {times} \({times} of it computing\); \d+ % of a processor"
    assert re.fullmatch(rf"\d+ epochs?: \d+ ok {late}", " ".join(TOO_SLOW.sub("", message).split()))


STOPPED = """
import signal, sys, time
from types import SimpleNamespace
from goldfield.cli import main
from goldfield.link import buses, serial_bus
from goldfield.sensor import finding, session

offset = [0.0]
signal.signal(signal.SIGCONT, lambda *_: offset.__setitem__(0, 30.0))
clock = SimpleNamespace(monotonic=lambda: time.monotonic() + offset[0], time=lambda: time.time() + offset[0])
finding.time = session.time = serial_bus.time = clock

class Told(serial_bus.SerialBus):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        print("open", file=sys.stderr, flush=True)

buses.SerialBus = Told
sys.exit(main(sys.argv[1:]))
"""
"""The program, on clocks that jump by 30 s when it goes on after a stop; it tells when it listens."""


def test_half_a_minute_in_which_the_program_is_stopped_costs_no_cycle(line):
    """SIGSTOP in the middle of a cycle; 300 cycles come meanwhile, as far as the port takes them."""
    cycles = [b"".join(encode_frame(*message) for message in cycle_messages(cycle)) for cycle in range(303)]
    command = [sys.executable, "-c", STOPPED, "run", "--site", str(SITE), "--json"]
    command += ["--port", line.path, "--listen-only", "--node", str(NODE)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr.readline() == "open\n"
        os.write(line.master, b"\0" + cycles[0] + cycles[1])
        lines = [json.loads(process.stdout.readline()) for _ in range(2)]
        rest = b"".join(cycles[2:])
        half = rest.index(b"\0", len(cycles[2]) // 2) + 1
        os.write(line.master, rest[:half])
        while struct.unpack("i", fcntl.ioctl(line.slave, termios.FIONREAD, bytes(4)))[0]:
            assert process.poll() is None  # it reads what has come
        process.send_signal(signal.SIGSTOP)
        assert os.WIFSTOPPED(os.waitpid(process.pid, os.WUNTRACED)[1])
        rest = rest[half:]
        os.set_blocking(line.master, False)
        try:
            while rest:
                rest = rest[os.write(line.master, rest) :]
        except BlockingIOError:
            pass  # the port is full, and the sensor waits
        os.set_blocking(line.master, True)
        process.send_signal(signal.SIGCONT)
        while rest:
            rest = rest[os.write(line.master, rest[:512]) :]
        lines += [json.loads(process.stdout.readline()) for _ in range(301)]
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate()
    assert process.returncode == 0, err
    assert [record["epoch"] for record in lines] == list(range(303))
    assert sum(record["lost"] for record in lines) == 0
    assert {record["status"] for record in lines} == {"ok"}
    assert "the link" not in err, "nothing came late, twice or of unknown cycles"


def test_the_terminal_of_the_command_is_no_port(line):
    before = termios.tcgetattr(line.slave)
    command = [sys.executable, "-m", "goldfield", "run", "--site", str(SITE), "--port", line.path]
    done = subprocess.run(command, stdin=line.slave, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == (
        f"goldfield: {line.path}: is the terminal of this command, not the port of a board: check --port\n"
    )
    assert termios.tcgetattr(line.slave) == before


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="there is no /proc")
def test_the_terminal_of_another_shell_is_no_port(capsys):
    child, master = pty.fork()
    if child == 0:
        os.write(1, os.ttyname(0).encode() + b"\n")
        signal.pause()
    try:
        path = os.read(master, 100).decode().strip()
        code, _, err = run(capsys, "--port", path)
        assert (code, err.count("\n")) == (2, 1)
        assert f"{path}: is the terminal of process {child} (" in err
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(master)

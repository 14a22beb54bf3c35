"""Interrupts that come at the worst moment: just before the program waits without end."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from goldfield.cli import interrupts
from goldfield.cli.interrupts import terminated_like_interrupted
from tests.host.fake_sensor import CHIPS, SITE, beacon_fields, log_of

HANGS_S = 300.0
"""What takes so long does not end."""
MISSED = """
import signal, sys
from goldfield.cli import main
signal.siginterrupt(signal.SIGINT, False)
sys.exit(main(sys.argv[1:]))
"""
"""The program, no system call of which Ctrl-C ends: as if it always came just before the call."""


def started(*words):
    command = [sys.executable, "-c", MISSED, *map(str, words)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, pipesize=4096)


def waits(process):
    """Wait until the program itself waits."""
    while Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "S":
        pass


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="there is no /proc")
def test_an_interrupt_just_before_the_program_waits_for_a_pipe_ends_it():
    rows = [f"{i}," + ",".join(repr(float(v)) for v in row) for i, row in enumerate(CHIPS @ beacon_fields())]
    with started("separate", "--site", SITE, "--json", "-") as process:
        process.stdin.write("\n".join(["chip,bx_T,by_T,bz_T", *rows, *rows[:1], ""]))
        process.stdin.flush()
        assert json.loads(process.stdout.readline())
        waits(process)
        process.send_signal(signal.SIGINT)
        assert process.wait(HANGS_S) == 130
        assert process.stderr.read() == ""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="there is no /proc")
def test_an_interrupt_just_before_the_program_waits_for_a_thread_ends_it(tmp_path):
    """The lines of a recording go to a pipe that nobody reads."""
    log = tmp_path / "a.log"
    log.write_text(log_of(range(20)))
    with started("run", "--site", SITE, "--log", log, "--json") as process:
        assert json.loads(process.stdout.readline())
        waits(process)
        process.send_signal(signal.SIGINT)
        process.wait(HANGS_S)
    assert process.returncode == 0


def terminated():
    with terminated_like_interrupted():
        os.kill(os.getpid(), signal.SIGTERM)
        raise AssertionError("it was not seen")


def test_behind_a_signal_everything_is_as_before():
    before = signal.getsignal(interrupts.WAKING), signal.getsignal(signal.SIGTERM)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            terminated()
    assert (signal.getsignal(interrupts.WAKING), signal.getsignal(signal.SIGTERM)) == before
    assert signal.set_wakeup_fd(-1) == -1
    assert "waker" not in [thread.name for thread in threading.enumerate()]


def test_elsewhere_than_in_the_main_thread_signals_are_left_alone():
    handlers = []

    def look():
        with terminated_like_interrupted():
            handlers.append(signal.getsignal(signal.SIGTERM))

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [before]

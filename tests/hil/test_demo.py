"""What `make run` shows, where there is no network at all."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from hil_sim import demo as demo_module
from hil_sim.clib import ROOT
from hil_sim.demo import main, play

NO_NETWORK = ["unshare", "-rn"]
"""A network name space of its own: its loopback interface is down."""


def demo(*arguments, within=()):
    command = [*within, sys.executable, "-m", "hil_sim.demo", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


def test_it_needs_no_network():
    if subprocess.run([*NO_NETWORK, "true"], check=False, stderr=subprocess.DEVNULL).returncode != 0:
        pytest.skip("this machine lets nobody make a network of his own")
    done = demo("--boards", "host", "--seconds", "0.5", within=NO_NETWORK)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^5 epochs: \d ok", done.stdout, re.M)


@pytest.mark.parametrize("seconds", ["nan", "0", "-1", "x", ""])
def test_seconds_that_are_none_are_told_in_a_sentence(capsys, seconds):
    with pytest.raises(SystemExit) as end:
        main(["--seconds", seconds])
    told = capsys.readouterr()
    assert (end.value.code, told.out) == (2, "")
    assert re.fullmatch(r"python -m hil_sim\.demo: argument --seconds: .* is no number of seconds .*\n", told.err)


RIG = "import json, time; print(json.dumps({'serial': 'PORT'}), flush=True); "
RUN = "import sys; assert sys.argv[-2:] == ['--port', 'PORT']; "


def python(program):
    return [sys.executable, "-c", program]


@pytest.mark.parametrize("code", [0, 2, 3])
def test_the_run_ends_the_demonstration_with_its_exit_code(code):
    """The rig would go on without end."""
    assert play(python(f"{RIG}time.sleep(1e6)"), python(f"{RUN}sys.exit({code})")) == code


@pytest.mark.parametrize(("code", "wanted"), [(0, 3), (4, 4)])
def test_a_rig_that_ends_too_early_ends_a_run_that_waits_without_end(capsys, monkeypatch, code, wanted):
    monkeypatch.setattr(demo_module, "LAST_WORDS_S", 0.0)
    assert play(python(f"{RIG}raise SystemExit({code})"), python(f"{RUN}import time; time.sleep(1e6)")) == wanted
    assert capsys.readouterr().err == "goldfield: the boards ended before all poses were there\n"


def test_a_rig_that_does_not_start_is_read_by_nobody():
    assert play(python("raise SystemExit(2)"), python("raise SystemExit(7)")) == 2


def test_nothing_of_it_is_bounded_by_the_wall_clock(monkeypatch):
    """The rig stands still until it is read, and the run waits for a sensor that is slow to be heard."""
    commands = []
    monkeypatch.setattr(demo_module, "play", lambda *given: commands.extend(given) or 0)
    assert main(["--seconds", "2"]) == 0
    rig, run = commands
    assert "--wait" in rig
    assert rig[rig.index("--seconds") + 1] == "65.0"
    assert "--reconnect" in run
    assert run[run.index("--seconds") + 1] == "2.0"

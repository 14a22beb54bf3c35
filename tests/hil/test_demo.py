"""What `make run` shows, where there is no network at all."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from hil_sim.clib import ROOT
from hil_sim.demo import main

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

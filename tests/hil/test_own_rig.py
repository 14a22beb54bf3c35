"""Tests on one's own rig: a project of somebody else, and a bench in another process in place of the boards."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from hil_sim.clib import ROOT

PROJECT = """
import pytest

def test_whatever_bench_there_is(open_bench):
    bench = open_bench("prigge8")
    assert len(bench.fields(2)) == 2
    assert not bench.truth()

@pytest.mark.simulated_bench
@pytest.mark.parametrize("number", range(3))
def test_with_faults(open_bench, number):
    open_bench("prigge8").rig.fault(1, "driver")

def test_without_a_bench():
    pass
"""
ROOM = ROOT / "docs/examples/room.toml"


@pytest.fixture
def project(tmp_path):
    (tmp_path / "test_it.py").write_text(PROJECT)
    return tmp_path


def run_pytest(directory, *options):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "hil_sim.pytest_plugin", *options]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=directory)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """The options that name a bench in another process, as a real one is named."""
    directory = tmp_path_factory.mktemp("rig")
    port, site = directory / "port", directory / "site.toml"
    command = [sys.executable, "-m", "hil_sim.command", "prigge8", "--boards", "host", "--wait"]
    command += ["--site", site, "--link", port]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as bench:
        bench.stdout.readline()
        yield "--goldfield-rig", f"serial:{port}", "--goldfield-site", site
        bench.terminate()


def test_what_applies_is_run_and_the_rest_is_told(project, rig):
    done = run_pytest(project, *rig)
    assert done.returncode == 0, done.stdout
    assert "goldfield: 3 deselected: they need the truth, faults or a scenario of their own, which only" in done.stdout
    assert re.search(r"^2 passed, 3 deselected", done.stdout, re.M)
    done = run_pytest(project, "-v", *rig)
    assert f"goldfield: {rig[1]}: sensor 100, 8 beacons of the site prigge8\n" in done.stdout


def test_the_tests_of_this_folder(rig):
    done = run_pytest(ROOT, "tests/hil", "--goldfield-rig", "host", "--collect-only")
    everything = int(re.search(r"^(\d+) tests collected", done.stdout, re.M)[1])
    done = run_pytest(ROOT, "tests/hil", *rig)
    assert done.returncode == 0, done.stdout
    assert f"goldfield: {everything - 3} deselected: " in done.stdout
    assert re.search(rf"^3 passed, {everything - 3} deselected", done.stdout, re.M)


SITE = ("--goldfield-site", ROOM)
NO_PORT = "serial:/dev/no-such-port"
REFUSED = [
    (("wood",), "wood: is none of emulated, host, serial:PATH or can:INTERFACE:CHANNEL"),
    (("serial:", *SITE), "serial:: is none of emulated, host, serial:PATH or can:INTERFACE:CHANNEL"),
    (("host:1",), "host:1: is none of emulated, host, serial:PATH or can:INTERFACE:CHANNEL"),
    ((NO_PORT,), f"{NO_PORT}: a real bench has a site: give --goldfield-site FILE, too"),
    ((NO_PORT, *SITE, "-n", "2"), f"{NO_PORT}: one process reads a bench at a time: leave out -n"),
    ((NO_PORT, *SITE), f"{NO_PORT}: /dev/no-such-port: there is no such port"),
    (
        (NO_PORT, "--goldfield-site", "nowhere.toml"),
        f"{NO_PORT}: nowhere.toml: there is no such site file: check the path",
    ),
]


@pytest.mark.parametrize(("options", "sentence"), REFUSED)
def test_a_rig_that_cannot_serve_is_told_once(project, options, sentence):
    done = run_pytest(project, "--goldfield-rig", *options)
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert done.stderr.strip() == f"ERROR: --goldfield-rig {sentence}"
    assert "Traceback" not in done.stdout


def test_collecting_asks_for_no_port(project):
    done = run_pytest(project, "--goldfield-rig", NO_PORT, *SITE, "--collect-only")
    assert done.returncode == 0
    assert "2/5 tests collected (3 deselected)" in done.stdout

"""Streams that are files, pipes, full or of another alphabet: each in a process of its own, as a shell starts it."""

import json
import os
import resource
import signal
import subprocess
import sys

import pytest

from hil_sim.clib import ROOT
from tests.host.fake_sensor import CHIPS, SITE, beacon_fields

EXAMPLES = ROOT / "docs" / "examples"
FIELDS, LOG = EXAMPLES / "fields.csv", EXAMPLES / "recording.log"
GOLDFIELD = [sys.executable, "-m", "goldfield"]


def run(*words, **streams):
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
    return subprocess.run([*GOLDFIELD, *map(str, words)], check=False, text=True, **streams)


@pytest.fixture(scope="module")
def poses_of_log():
    """The lines that the recording's poses are, told without a pipe or a full disk."""
    done = run("run", "--site", SITE, "--log", LOG, "--json")
    assert done.returncode == 0
    return done.stdout.splitlines()


def test_a_table_from_stdin_and_a_site_from_stdin():
    with FIELDS.open() as table:
        piped = run("locate", "--site", SITE, "-", "--json", stdin=table)
    with SITE.open() as site:
        again = run("locate", "--site", "-", FIELDS, "--json", stdin=site)
    assert (piped.returncode, len(piped.stdout.splitlines())) == (0, 10)
    assert again.stdout == piped.stdout


def test_a_pose_comes_as_soon_as_its_epoch_is_whole():
    lines = FIELDS.read_text().splitlines(keepends=True)
    command = [*GOLDFIELD, "locate", "--site", str(SITE), "-", "--json"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write("".join(lines[:10]))
        process.stdin.flush()
        assert json.loads(process.stdout.readline())["status"] == "ok"  # the pipe is still open
        process.stdin.close()
        assert process.wait() == 0


def test_fields_of_a_recording_through_a_pipe(poses_of_log):
    line = f'"$0" -m goldfield run --site {SITE} --log - --fields - --json < {LOG} 2> /dev/null |'
    line += f' "$0" -m goldfield locate --site {SITE} - --json'
    done = subprocess.run(["sh", "-c", line, sys.executable], check=False, text=True, capture_output=True)
    assert done.returncode == 0
    located, live = ([json.loads(text) for text in lines] for lines in (done.stdout.splitlines(), poses_of_log))
    assert [pose["position_m"] for pose in located] == [pose["position_m"] for pose in live]


def test_a_recording_on_stdout_is_the_recording():
    done = run("run", "--site", SITE, "--log", LOG, "--record", "-")
    assert done.returncode == 0
    assert [line.split()[2] for line in done.stdout.splitlines()] == [
        line.split()[2] for line in LOG.read_text().splitlines()
    ]
    assert "epochs: " in done.stderr


def test_an_input_that_is_the_output_of_the_shell(tmp_path):
    table = tmp_path / "fields.csv"
    table.write_text(FIELDS.read_text())
    with table.open("a") as out:
        done = run("locate", "--site", SITE, table, stdout=out)
    assert done.returncode == 2
    assert "is the file of FIELDS.csv, and stdout goes into it" in done.stderr
    assert table.read_text() == FIELDS.read_text()


def test_letters_that_the_terminal_does_not_have(tmp_path):
    site, table = tmp_path / "site.toml", tmp_path / "fields.csv"
    site.write_text(SITE.read_text().replace('"b1"', '"Tür"'), encoding="utf-8")
    table.write_text(FIELDS.read_text().replace(",b1,", ",Tür,").replace("e-0", "e-1", 3), encoding="utf-8")
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C"}
    done = run("locate", "--site", site, table, env=environment)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))


def test_a_full_disk_leaves_the_old_table_and_tells(tmp_path):
    samples, table = tmp_path / "samples.csv", tmp_path / "fields.csv"
    rows = [f"{i}," + ",".join(repr(float(v)) for v in row) for i, row in enumerate(CHIPS @ beacon_fields())]
    samples.write_text("\n".join(["chip,bx_T,by_T,bz_T", *rows]))
    table.write_text("a day of work\n")
    words = ["separate", "--site", SITE, samples, "--fields", table, "--force"]
    done = run(*words, preexec_fn=limited)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1].startswith(f"goldfield: {table}: the fields cannot be written: ")
    assert table.read_text() == "a day of work\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fields.csv", "samples.csv"]
    assert run(*words).returncode == 0
    assert table.read_text().startswith("epoch,t_s,beacon,")


@pytest.mark.parametrize("quiet", [(), ("-q",)])
@pytest.mark.parametrize("option", ["--record", "--fields"])
def test_a_full_disk_ends_a_recording_at_a_whole_message_and_not_the_run(tmp_path, poses_of_log, option, quiet):
    target = tmp_path / "out.log"
    done = run("run", "--site", SITE, "--log", LOG, "--json", *quiet, option, target, preexec_fn=limited)
    assert done.returncode == 3
    assert len(done.stdout.splitlines()) == len(poses_of_log)
    assert target.read_bytes() == b"" or target.read_bytes().endswith(b"\n")
    assert "the run goes on" in done.stderr


def test_a_full_disk_leaves_nothing_of_a_summary(tmp_path):
    """Its first part lay beside it, under another name."""
    target = tmp_path / "summary.json"
    words = ["run", "--site", SITE, "--log", LOG, "--json", "--summary", target]
    done = run(*words, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)))
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1].startswith(f"goldfield: {target}: the summary cannot be written: ")
    assert list(tmp_path.iterdir()) == []
    assert run(*words).returncode == 0
    assert target.read_text().startswith('{"epochs": ')


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_no_half_of_a_table(tmp_path, number):
    """Whatever the command: here `separate`, which has written a cycle and waits for more."""
    rows = [f"{i}," + ",".join(repr(float(v)) for v in row) for i, row in enumerate(CHIPS @ beacon_fields())]
    words = [*GOLDFIELD, "separate", "--site", str(SITE), "--fields", str(tmp_path / "fields.csv"), "--json", "-"]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as it:
        it.stdin.write("\n".join(["chip,bx_T,by_T,bz_T", *rows, *rows[:1], ""]))
        it.stdin.flush()
        assert json.loads(it.stdout.readline())
        it.send_signal(number)
        assert it.wait() == 130
        assert it.stderr.read() == ""
    assert not list(tmp_path.iterdir())


def test_an_interrupt_before_anything_is_loaded_is_no_traceback():
    program = """
import sys
class Slow:
    def find_spec(self, name, *_):
        if name == "goldfield.cli.entry":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Slow())
from goldfield.cli import main
sys.exit(main(["ports"]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is always full")  # noqa: PTH110
@pytest.mark.parametrize("words", [("completion", "bash"), ("locate", "--site", SITE, FIELDS)])
def test_a_full_stdout_is_called_the_output(words):
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = run(*words, stdout=full)
    assert done.returncode == 3
    last = done.stderr.splitlines()[-1]
    assert last.startswith("goldfield: the output cannot be written: No space left on device")

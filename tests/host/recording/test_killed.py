"""A run that is killed at any moment leaves a recording that opens, with all but the last of what it had printed."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader

from goldfield.cli import main
from goldfield.recording.mcap_file import END
from hil_sim.clib import ROOT
from tests.host.recording.mcap_file import topics

EXAMPLES = ROOT / "docs/examples"
SITE = EXAMPLES / "room.toml"
MOST_POSES = 400
MOST_LINES = 100_000
"""Poses that are printed while a recording is waited for; one that is written at all is there far earlier."""


def size_of(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def killed_run(path: Path, poses: int, *, written: bool) -> list[dict]:
    """Run on a log without end, kill it when it has printed so many poses, and return what it had printed.

    Parameters
    ----------
    written : bool
        Whether the run goes on until these poses are known to be in the recording: it has then grown twice, and the
        second time by what came after the first.
    """
    words = [sys.executable, "-m", "goldfield", "run", "--log", "-", "--site", SITE, "--json", "--record", path]
    endless = ["sh", "-c", 'while cat "$1"; do :; done', "sh", EXAMPLES / "recording.log"]
    with (
        subprocess.Popen(endless, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as feeder,
        subprocess.Popen(words, stdin=feeder.stdout, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as run,
    ):
        feeder.stdout.close()
        lines = [run.stdout.readline() for _ in range(poses)]
        sizes = {size_of(path)}
        while written and len(sizes) < 3 and len(lines) < MOST_LINES:
            lines.append(run.stdout.readline())
            sizes.add(size_of(path))
        run.send_signal(signal.SIGKILL)
    assert len(sizes) == 3 or not written
    return [json.loads(line) for line in lines]


def check(path: Path, printed: list[dict], capsys) -> int:
    """Check what is left of a killed run; return how many of its poses."""
    if not size_of(path):
        return 0
    assert path.read_bytes().endswith(END)
    with path.open("rb") as file:
        assert SeekingReader(file, validate_crcs=True).get_header() is not None
    kept = [json.loads(message.data) for message in topics(path).get("/goldfield/line", [])]
    for line, wanted in zip(kept, printed, strict=False):
        assert {key: line[key] for key in wanted} == wanted
    capsys.readouterr()
    code = main(["run", "--log", str(path), "--site", str(SITE), "--json"])
    again = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert code == (0 if again else 2)  # what was flushed may be too little for a cycle
    assert [line["position_m"] for line in again[: len(kept)]] == [line["position_m"] for line in kept]
    assert len(again) >= len(kept)
    return len(kept)


def check_messages(path: Path, printed: list[dict], capsys) -> int:
    """Check what is left of a killed run in a format for messages; return how many poses it holds."""
    if not size_of(path):
        return 0
    capsys.readouterr()
    main(["run", "--log", str(path), "--site", str(SITE), "--json"])
    again = [json.loads(line) for line in capsys.readouterr().out.splitlines()][:-1]  # the last is of a part of a cycle
    for line, wanted in zip(again, printed, strict=False):
        assert line["position_m"] == wanted["position_m"]
    return len(again)


CHECKS = {".mcap": check, ".blf": check_messages, ".log": check_messages}


@pytest.mark.parametrize("written", [False, True])
@pytest.mark.parametrize(("ending", "seed"), [(".mcap", 0), (".mcap", 1), (".blf", 0), (".log", 0)])
def test_a_killed_run_leaves_a_recording_that_opens(tmp_path, capsys, ending, seed, written):
    """What was known to be written is there, by the poses: the clock of a machine at work tells nothing."""
    poses = int(np.random.default_rng([14, seed]).integers(1, MOST_POSES))
    path = tmp_path / f"a{ending}"
    kept = CHECKS[ending](path, killed_run(path, poses, written=written), capsys)
    assert kept >= poses or not written


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".mcap", ".blf", ".log"])
def test_fifty_killed_runs_leave_recordings_that_open(tmp_path, capsys, ending):
    lost = []
    for number, poses in enumerate(np.random.default_rng(50).integers(1, MOST_POSES, 50).tolist()):
        path, written = tmp_path / f"{number}{ending}", bool(number % 2)
        printed = killed_run(path, poses, written=written)
        kept = CHECKS[ending](path, printed, capsys)
        assert kept >= poses or not written
        lost.append(max(0, len(printed) - kept))
    with capsys.disabled():
        print(f"\n50 killed runs, {ending}: lost {np.median(lost):.0f} poses in the median, at most {max(lost)}")

"""A run that is killed at any moment leaves a recording that opens, with all but the last of what it had printed."""

import json
import signal
import subprocess
import sys
import time
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


def killed_run(path: Path, poses: int) -> list[tuple[float, dict]]:
    """Run on a log without end, kill it when it has printed so many poses, and return them with their times."""
    words = [sys.executable, "-m", "goldfield", "run", "--log", "-", "--site", SITE, "--json", "--record", path]
    endless = ["sh", "-c", 'while cat "$1"; do :; done', "sh", EXAMPLES / "recording.log"]
    with (
        subprocess.Popen(endless, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as feeder,
        subprocess.Popen(words, stdin=feeder.stdout, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as run,
    ):
        feeder.stdout.close()
        lines = [(run.stdout.readline(), time.monotonic()) for _ in range(poses)]  # a line is there before its time
        run.send_signal(signal.SIGKILL)
    return [(came_s, json.loads(line)) for line, came_s in lines]


def check(path: Path, printed: list[tuple[float, dict]], capsys) -> float:
    """Check what is left of a killed run; return how many seconds of its poses are lost."""
    if not path.exists() or not path.stat().st_size:
        return printed[-1][0] - printed[0][0]
    assert path.read_bytes().endswith(END)
    with path.open("rb") as file:
        assert SeekingReader(file, validate_crcs=True).get_header() is not None
    kept = [json.loads(message.data) for message in topics(path).get("/goldfield/line", [])]
    for line, (_, wanted) in zip(kept, printed, strict=False):
        assert {key: line[key] for key in wanted} == wanted
    capsys.readouterr()
    code = main(["run", "--log", str(path), "--site", str(SITE), "--json"])
    again = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert code == (0 if again else 2)  # what was flushed may be too little for a cycle
    assert [line["position_m"] for line in again[: len(kept)]] == [line["position_m"] for line in kept]
    assert len(again) >= len(kept)
    return printed[-1][0] - printed[len(kept)][0] if len(kept) < len(printed) else 0.0


def check_messages(path: Path, printed: list[tuple[float, dict]], capsys) -> float:
    """Check what is left of a killed run in a format for messages; return how many seconds of its poses are lost."""
    if not path.exists() or not path.stat().st_size:
        return printed[-1][0] - printed[0][0]
    capsys.readouterr()
    main(["run", "--log", str(path), "--site", str(SITE), "--json"])
    again = [json.loads(line) for line in capsys.readouterr().out.splitlines()][:-1]  # the last is of a part of a cycle
    for line, (_, wanted) in zip(again, printed, strict=False):
        assert line["position_m"] == wanted["position_m"]
    return printed[-1][0] - printed[len(again)][0] if len(again) < len(printed) else 0.0


CHECKS = {".mcap": check, ".blf": check_messages, ".log": check_messages}


@pytest.mark.parametrize(("ending", "seed"), [(".mcap", 0), (".mcap", 1), (".mcap", 2), (".blf", 0), (".blf", 1)])
def test_a_killed_run_leaves_a_recording_that_opens(tmp_path, capsys, ending, seed):
    poses = int(np.random.default_rng([14, seed]).integers(1, MOST_POSES))
    path = tmp_path / f"a{ending}"
    CHECKS[ending](path, killed_run(path, poses), capsys)


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".mcap", ".blf", ".log"])
def test_fifty_killed_runs_leave_recordings_that_open(tmp_path, capsys, ending):
    lost_s = []
    for poses in np.random.default_rng(50).integers(1, MOST_POSES, 50).tolist():
        path = tmp_path / f"{len(lost_s)}{ending}"
        lost_s.append(CHECKS[ending](path, killed_run(path, poses), capsys))
    with capsys.disabled():
        print(f"\n50 killed runs, {ending}: lost {np.median(lost_s):.2f} s in the median, at most {max(lost_s):.2f} s")
    assert max(lost_s) < 1.0

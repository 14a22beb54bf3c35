"""``kill -9`` of a whole run at random moments: every recording opens and lacks at most 0.2 s of what was printed."""

import json
import os
import select
import signal
import subprocess
import sys

import numpy as np
import pytest

import goldfield

CYCLE_S = 0.1
MOST_LOST_S = 0.2


@pytest.mark.parametrize("kills", [5, pytest.param(50, marks=pytest.mark.slow)])
def test_every_recording_of_a_killed_run_opens(tmp_path, kills):
    rng = np.random.default_rng(kills)
    site = tmp_path / "site.toml"
    words = ["hil", "prigge8", "--boards", "host", "--json", "--site", str(site), "--truth", str(tmp_path / "truth")]
    with subprocess.Popen([sys.executable, "-m", "goldfield", *words], stdout=subprocess.PIPE, text=True) as bench:
        try:
            port = json.loads(bench.stdout.readline())["serial"]
            for place in range(kills):
                path = tmp_path / f"{place}.log"
                printed = killed_run(port, site, path, int(rng.integers(1, 7)), rng.uniform(0.0, CYCLE_S))
                with goldfield.open_log(path, site=site) as log:
                    read = [pose for pose in log.poses() if pose.status is goldfield.Status.OK]
                assert read
                assert printed["t_s"] - read[-1].time_s <= MOST_LOST_S + 1e-6
        finally:
            bench.terminate()


def killed_run(port, site, path, lines, more_s):
    """Record until some lines are printed and a while longer; the last line that was printed before the kill."""
    words = ["run", "--port", port, "--site", str(site), "--json", "--record", str(path)]
    run = subprocess.Popen([sys.executable, "-m", "goldfield", *words], stdout=subprocess.PIPE)
    try:
        printed = [json.loads(run.stdout.readline()) for _ in range(lines)]
        select.select([run.stdout], [], [], more_s)
    finally:
        os.kill(run.pid, signal.SIGKILL)
        rest = run.communicate()[0]
    whole = [json.loads(line) for line in rest.splitlines(keepends=True) if line.endswith(b"\n")]
    return [*printed, *whole][-1]

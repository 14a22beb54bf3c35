"""How late the lines of ``goldfield run --rate`` are on this machine, with what its sensor sends played as it came."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import tempfile
import threading
import time
import tty
from pathlib import Path

from hil_sim.bench import SimulatedBench
from tests.bench.rate_boards import set_parameter

STEP_S = 2.5e-4
"""Bytes that leave the sensor within such a time are played together; a block's take 0.7 ms."""
AHEAD_S = 3.0
"""The line is silent for so long before the playing begins, while the run starts."""
HELD_UP_S = 0.02
"""A player that was held up for longer, as by a run that does not read yet, goes on later and not faster."""
SERIAL = 1
"""Value of the parameter ``blocks``."""
SPARE_S = 2.0
"""So much more is recorded than is read."""


def recorded(scenario, boards, seconds):
    """Return what a sensor sends on its serial line, each part with its virtual time, and the path of the site file."""
    folder = Path(tempfile.mkdtemp(prefix="goldfield-figures-"))
    bench = SimulatedBench(scenario, boards, folder)
    set_parameter(bench, "blocks", SERIAL)
    begin_s, parts = bench.rig.now_s, []
    while bench.rig.now_s < begin_s + seconds:
        bench.rig.advance(STEP_S)
        data = bench.rig.serial_read()
        if data:
            parts.append((bench.rig.now_s - begin_s, data))
    bench.close()
    return parts, folder / "site.toml"


def played(parts, site_path, rate_hz):
    """Play what a sensor sent at the times at which it did into a run; return the run's summary."""
    leader, follower = pty.openpty()
    tty.setraw(leader)
    folder = Path(tempfile.mkdtemp(prefix="goldfield-figures-"))
    command = [str(Path(sys.executable).with_name("goldfield")), "run", "--port", os.ttyname(follower), "--listen-only"]
    command += ["--node", "100"]  # else it looks around for others first, and works off what came meanwhile
    command += ["--site", str(site_path), "--rate", f"{rate_hz:g}", "--json", "--summary", str(folder / "summary.json")]
    command += ["--seconds", f"{parts[-1][0] - SPARE_S:g}"]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    threading.Thread(target=run.stdout.read, daemon=True).start()
    time.sleep(AHEAD_S)
    begin_s = time.monotonic()
    for time_s, data in parts:
        early_s = begin_s + time_s - time.monotonic()
        if early_s < -HELD_UP_S:
            begin_s -= early_s
        time.sleep(max(0.0, early_s))
        os.write(leader, data)
        if run.poll() is not None:
            break
    run.wait(timeout=60.0)
    os.close(leader)
    os.close(follower)
    return json.loads((folder / "summary.json").read_text())

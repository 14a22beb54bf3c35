"""How late the lines of ``goldfield run --rate`` are on this machine, with what its sensor sends played as it came.

What else the machine does is in these times. `work_of_blocks` tells what the filter itself computes for each block: the
least processor time of several replays of the same blocks, since others only add to it.
"""

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
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np

from goldfield.link.blocks import BlockAssembler
from goldfield.track.blocks import BlockFilter
from goldfield_protocol import decode
from goldfield_protocol.framing import FrameDecoder
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


def blocks_of(parts, site, node=100):
    """Return the blocks of what a sensor sent."""
    decoder, assembler = FrameDecoder(), BlockAssembler(site.codes, site.chips, site.chip_period_s)
    blocks = []
    for time_s, data in parts:
        for frame in decoder.feed(data):
            message = decode(frame.identifier, frame.data)
            if message is not None and message.node == node:
                blocks += assembler.feed(message, time_s)
    return blocks


class _Aside(Executor):
    """Judges a cycle at once, and keeps by itself what that takes: a live run has another thread for it.

    Attributes
    ----------
    spent_s : list of float
        Processor time of each cycle.
    """

    def __init__(self):
        self.spent_s = []

    def submit(self, call, /, *arguments):
        """Make a call, and measure it."""
        future = Future()
        begin_s = time.thread_time()
        future.set_result(call(*arguments))
        self.spent_s.append(time.thread_time() - begin_s)
        return future


def work_of_blocks(site, blocks, replays):
    """Return the processor time that the filter takes for each block, and that for judging each cycle.

    Both are the least of several replays of the same blocks, each with a new filter; the first of all, in which code is
    used for the first time, is not among them.
    """
    each, cycles = [], []
    for _ in range(1 + replays):
        aside = _Aside()
        track, spent_s = BlockFilter(site, aside=aside), []
        for block in blocks:
            begin_s, judged = time.thread_time(), len(aside.spent_s)
            track.update(block)
            spent_s.append(time.thread_time() - begin_s - sum(aside.spent_s[judged:]))
        each.append(spent_s)
        cycles.append(aside.spent_s)
    return np.min(each[1:], axis=0), np.min(cycles[1:], axis=0)

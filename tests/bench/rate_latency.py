"""How long after a block's last chip its messages have left the sensor, in the rig's time, and its pose is known."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from goldfield.link.blocks import BLOCK_CHIPS, BlockAssembler
from goldfield_protocol import decode
from tests.bench.motion_trials import CHIPS
from tests.bench.rate_boards import end_of_chips_s, set_parameter, truth_of
from tests.bench.rate_ways import errors_of

STEP_S = 2.5e-5
"""Serial bytes are looked at in such steps: their time of arrival is known to that."""
SERIAL, CAN = 1, 2
"""Values of the parameter ``blocks``."""
SETTLED_BLOCKS = 66
"""Blocks that are not looked at: the first ones wait for the header of a cycle."""


@dataclass(frozen=True, eq=False)
class Latency:
    """Blocks as the host has them.

    Attributes
    ----------
    arrival_s : ndarray, shape (n,)
        From the end of the block's last chip to the end of the block's last message, virtual time.
    update_s : ndarray, shape (n,)
        Processor time of the filter for the block.
    errors : Errors
        How far the poses are off at the true ends of the blocks.
    """

    arrival_s: object
    update_s: object
    errors: object


def latency(bench, block_filter, seconds):
    """Run a bench whose sensor sends blocks on the bench's link, and return how late each block and its pose is."""
    set_parameter(bench, "blocks", SERIAL if bench.link == "serial" else CAN)
    node = bench.scenario.sensor.node
    assembler = BlockAssembler(bench.site.codes, bench.site.chips, bench.site.chip_period_s)
    ends, arrivals, spent, poses = [], [], [], []
    stop_s = bench.rig.now_s + seconds
    while bench.rig.now_s < stop_s:
        bench.rig.advance(STEP_S)
        for arrival_s, frame in _received(bench):
            message = decode(frame.identifier, frame.data)
            if message is None or message.node != node:
                continue
            for block in assembler.feed(message, arrival_s):
                begin_s = time.process_time()
                pose = block_filter.update(block)
                spent.append(time.process_time() - begin_s)
                ends.append(block.cycle * CHIPS + block.chip + BLOCK_CHIPS - 1)
                arrivals.append(arrival_s)
                poses.append(pose)
    known = np.array(ends) < (len(bench.rig.sync_edges_s()) - 1) * CHIPS
    known[:SETTLED_BLOCKS] = False
    numbers = np.array(ends)[known]
    errors = errors_of(np.array(poses)[known], *truth_of(bench, numbers))
    late_s = np.array(arrivals)[known] - end_of_chips_s(bench, numbers)
    return Latency(late_s, np.array(spent)[known], errors)


def _received(bench):
    """Return the frames since the last call, each with the virtual time of its end."""
    if bench.link == "can":
        return [(frame.time_s, frame) for frame in bench.rig.can_read()]
    return [(bench.rig.now_s, frame) for frame in bench.decoder.feed(bench.rig.serial_read())]

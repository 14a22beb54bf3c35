"""How long after a block's last chip its pose is known: virtual time up to the last message, this machine's after it.

The first part is that of `make rate-figures`, on host boards; the second is the processor's time of the
filter's update by the block. No peer does this.
"""

from __future__ import annotations

import numpy as np

from goldfield.track.blocks import BlockFilter
from tests.bench.peers.bench import Bench
from tests.bench.peers.row import Goal, Row
from tests.bench.rate_boards import open_bench, scenario_file
from tests.bench.rate_latency import latency

SUBJECT = "latency"
SECONDS, NOISE_T, SEED = 1.0, 2e-7, 0
MOST_MS = 5.0
"""From the last chip to the pose that the issue asks for."""


def rows(_: Bench) -> list[Row]:
    """Return the rows of the subject: 99 % of the blocks are as quick or quicker."""
    found = []
    for link in ("serial", "can"):
        stage = open_bench(scenario_file("1 m/s, 1 rad/s", SEED, NOISE_T), "host", link)
        seen = latency(stage, BlockFilter(stage.site), SECONDS)
        stage.close()
        arrival_ms, update_ms = 1e3 * np.asarray(seen.arrival_s), 1e3 * np.asarray(seen.update_s)
        middle, most = (float(part) for part in np.quantile(arrival_ms + update_ms, (0.5, 0.99)))
        goal = Goal("ours", at_most=MOST_MS)
        found += [
            Row(SUBJECT, f"last chip to last message on {link}, 99 %", "ms", float(np.quantile(arrival_ms, 0.99))),
            Row(SUBJECT, f"the filter's update by a block from {link}, median", "ms", float(np.median(update_ms))),
            Row(SUBJECT, f"last chip to pose on {link}, median", "ms", middle, goal=goal),
            Row(SUBJECT, f"last chip to pose on {link}, 99 %", "ms", most, goal=goal),
        ]
    return found

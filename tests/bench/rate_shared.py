"""Several sensors on one CAN that all send blocks: what comes of each, how old it is, and what becomes of the cycles.

The further sensors are those of anchors: they run the same services as the sensor board, and send the same messages.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from goldfield.link.blocks import BLOCK_CHIPS, BlockAssembler
from goldfield.link.requests import set_request
from goldfield_protocol import decode
from goldfield_protocol.parameters import PARAMETERS, Kind
from hil_sim import clib
from tests.bench.rate_boards import end_of_chips_s

ANCHOR_SENSOR = "[beacon.sensor]\nposition_m = {position}\nrotation_vector_rad = [0.1, 0.2, {turn}]\n"
SETTLE_S = 0.5
"""Time of the bench that is not looked at, after all sensors have been set."""
STEP_S = 0.05
HEADERS_S = 0.25
"""Time before what is looked at: the first blocks wait for the header of a cycle."""
CAN = 2
"""Value of the parameter ``blocks``."""


@dataclass
class Seen:
    """What came of one sensor over the bus.

    Attributes
    ----------
    blocks : list of (int, float)
        For each whole block the number of its last chip, and the time at which its last message was through.
    cycles : list of (int, float)
        The same of each cycle of which all fields came.
    lost : int
        Blocks that did not come between two that did.
    counters : dict of int to int
        What the board says of its errors.
    """

    blocks: list[tuple[int, float]] = field(default_factory=list)
    cycles: list[tuple[int, float]] = field(default_factory=list)
    lost: int = 0
    counters: dict[int, int] = field(default_factory=dict)

    def late_ms(self, bench, what):
        """Return how old ``blocks`` or ``cycles`` were when they had come, ms: median and most."""
        last = (len(bench.rig.sync_edges_s()) - 1) * bench.site.chips
        known = [pair for pair in getattr(self, what) if pair[0] < last]
        if not known:
            return np.nan, np.nan
        numbers, times_s = np.array(known).T
        late_s = times_s - end_of_chips_s(bench, numbers)
        return 1e3 * float(np.median(late_s)), 1e3 * float(late_s.max())


def shared_scenario(sensors, path):
    """Write prigge8 with so many sensors on its bus; none of them computes poses. Returns the file's name."""
    text = (clib.ROOT / "hil_sim/scenarios/prigge8.toml").read_text()
    head, *beacons = text.split("[[beacon]]\n")
    places = np.random.default_rng(5).uniform(0.4, 1.7, (len(beacons), 3)).round(3).tolist()
    text = head.replace("pose = 1 ", "pose = 0 ")
    for number, (beacon, place) in enumerate(zip(beacons, places, strict=True)):
        text += f"[[beacon]]\n{beacon}"
        if number < sensors - 1:
            text += ANCHOR_SENSOR.format(position=place, turn=0.3 * number) + "\n"
    path.write_text(text)
    return str(path)


def nodes_of(bench, sensors):
    """Return the nodes of the sensor and of the anchors."""
    return [bench.scenario.sensor.node, *(beacon.node for beacon in bench.scenario.beacons[: sensors - 1])]


def ask_for_blocks(bench, node, codes):
    """Set a sensor's list of codes, and make it send blocks on CAN."""
    wanted = {PARAMETERS["code_list"].identifier(place): code for place, code in enumerate(codes)}
    wanted |= {PARAMETERS["code_count"].first: len(codes), PARAMETERS["blocks"].first: CAN}
    for parameter, value in wanted.items():
        bench.rig.can_write(*set_request(node, parameter, value, Kind.UNSIGNED))
    bench.rig.advance(STEP_S)


def listen(bench, nodes, codes, seconds):
    """Run on, and return what came of each node and how busy the bus was."""
    site, rig = bench.site, bench.rig
    seen = {node: Seen() for node in nodes}
    assemblers = {node: BlockAssembler(codes, site.chips, site.chip_period_s) for node in nodes}
    open_cycles = {}
    rig.can_read()
    steps, early = round(seconds / STEP_S), round(HEADERS_S / STEP_S)
    for step in range(-early, steps):
        if step == 0:
            seen = {node: Seen() for node in nodes}
            lost = {node: assembler.lost for node, assembler in assemblers.items()}
            busy_ps = rig.can_statistics()["busy_ps"]
        rig.advance(STEP_S)
        for frame in rig.can_read():
            message = decode(frame.identifier, frame.data)
            if message is None or message.node not in seen:
                continue
            found = seen[message.node]
            for block in assemblers[message.node].feed(message, frame.time_s):
                found.blocks.append((block.cycle * site.chips + block.chip + BLOCK_CHIPS - 1, frame.time_s))
            if message.name == "EPOCH":
                open_cycles[message.node] = int(message.signals["cycle"]), set(codes)
            elif message.name == "FIELD" and message.node in open_cycles:
                cycle, missing = open_cycles[message.node]
                missing.discard(message.index)
                if not missing:
                    found.cycles.append(((cycle + 1) * site.chips - 1, frame.time_s))
            elif message.name == "COUNTER":
                found.counters[message.index] = int(message.signals["value"])
    for node, assembler in assemblers.items():
        seen[node].lost = assembler.lost - lost[node]
    return seen, (rig.can_statistics()["busy_ps"] - busy_ps) * 1e-12 / (steps * STEP_S)


def shared(bench, sensors, codes, seconds):
    """Let so many sensors send blocks of so many codes; return what `listen` does, and the nodes."""
    listed = [*bench.site.codes, *range(100, 164)][:codes]
    nodes = nodes_of(bench, sensors)
    for node in nodes:
        ask_for_blocks(bench, node, listed)
    bench.rig.advance(SETTLE_S)
    return listen(bench, nodes, listed, seconds)

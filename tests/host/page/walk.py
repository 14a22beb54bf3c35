"""A recording of a sensor that walks through the room of eight beacons, all boards on one bus, with two faults."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield_protocol import encode
from goldfield_protocol.parameters import PARAMETERS
from tests.host.fake_sensor import (
    ATTITUDE,
    CODES,
    CYCLE_S,
    beacon_fields,
    candump,
    cycle_messages,
    heartbeat,
)

BEACON_NODES = tuple(range(11, 19))
FIRST_FAULT_S, LAST_FAULT_S = 9.0, 13.0
"""The coil of the third beacon is open between these times."""
BROKEN = 2
WEAK, WEAKENED = 5, 0.8
"""The sixth beacon's field is weaker than the site says, its current is not."""


def place(time_s):
    """Return where the sensor is, a figure of eight that also rises and sinks."""
    angle = 2.0 * math.pi * time_s / 20.0
    return np.array([1.07 + 0.62 * math.sin(angle), 1.07 + 0.5 * math.sin(2.0 * angle), 0.9 + 0.3 * math.cos(angle)])


def attitude(time_s):
    """Return how the sensor is turned."""
    return ATTITUDE * Rotation.from_rotvec([0.2 * math.sin(time_s), 0.0, 0.15 * time_s])


def broken(time_s):
    """Tell whether the coil is open."""
    return FIRST_FAULT_S <= time_s < LAST_FAULT_S


def board_messages(time_s):
    """Return what the eight beacons say of themselves at a time."""
    said = []
    for row, node in enumerate(BEACON_NODES):
        open_coil = row == BROKEN and broken(time_s)
        current = 0.0 if open_coil else 10.0
        status = {"current": current, "reference": 10.0, "target": 10.0, "over_current": 0, "open_coil": open_coil}
        status |= {"driver_fault": 0, "enabled": not open_coil, "locked": 1, "phase": 20 * row}
        health = {"cause": 0, "locked_out": 0, "headroom_lost": 0, "trips": 0, "wait": 0, "supply": 24.0}
        health |= {"coil_temperature": 31.0 + row + 0.2 * time_s, "driver_temperature": 38.0, "rms": 10.0, "direct": 0}
        said += [
            heartbeat(node=node, role=0),
            encode("DRIVE_STATUS", status, node=node, index=0),
            encode("DRIVE_HEALTH", health, node=node, index=0),
        ]
    return said


def identities():
    """Return the answers that tell which board is which beacon."""
    said = []
    for node, code in zip(BEACON_NODES, CODES, strict=True):
        for name, value in (("code", code), ("waveform", 0)):
            signals = {"kind": 0, "status": 0, "value_unsigned": value}
            said.append(encode("PARAM_VALUE", signals, node=node, index=PARAMETERS[name].first))
    return said


def walk(cycles, *, faults=True):
    """Return the recording of so many cycles as lines of candump."""
    lines = [(0.0, message) for message in (heartbeat(), *board_messages(0.0), *identities())]
    counted = encode("COUNTER", {"counter": 3, "value": 2}, node=BEACON_NODES[0], index=3)
    lines.append((0.0, counted))
    for cycle in range(cycles):
        middle_s = (cycle + 0.5) * CYCLE_S
        fields = beacon_fields(place(middle_s), attitude(middle_s))
        if faults:
            fields[WEAK] *= WEAKENED
            fields[BROKEN] *= 0.0 if broken(middle_s) else 1.0
        end_s = (cycle + 1) * CYCLE_S
        messages = cycle_messages(cycle, fields=fields)
        if cycle % 3 == 0:
            messages += board_messages(middle_s if faults else 0.0)
        lines += [(end_s + 1e-4 * i, message) for i, message in enumerate(messages)]
    return candump(lines)

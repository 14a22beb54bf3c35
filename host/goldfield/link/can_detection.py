"""``python -m goldfield.link.can_detection SECONDS [NOT_THIS...]``: the CAN devices that vendors' libraries name.

It runs as a process of its own (`goldfield.link.ports.can_interfaces`), because a vendor's library may print, hang or
crash. The last line of its stdout is a JSON list of pairs of interface and channel.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time

import can


def detected(seconds: float, without: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return interface and channel of each device, those of some interfaces left out."""
    deadline = time.monotonic() + seconds
    found: list[tuple[str, str]] = []
    for interface in sorted(set(can.VALID_INTERFACES) - set(without)):
        try:
            configurations = can.detect_available_configs(interface, timeout=max(0.1, deadline - time.monotonic()))
        except Exception:  # whatever a vendor's library raises, it names no device
            continue
        found += [(str(one["interface"]), str(one["channel"])) for one in configurations]
    return sorted(set(found))


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    print(json.dumps(detected(float(sys.argv[1]), tuple(sys.argv[2:]))), flush=True)
    os._exit(0)  # a library that still searches must not hold up the end

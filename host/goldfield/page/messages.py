"""The messages of the live page, as JSON: the site once, each epoch and fix, the health of the boards now and then.

`docs/live_page.md` documents every key. A message is a JSON object whose ``type`` tells what it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from goldfield.nodes.roster import Node, Roster
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.site import Site
from goldfield.site.coil_shapes import frame
from goldfield.site.model import Beacon
from goldfield.types import Finding, FloatArray, Pose
from goldfield.view.monitor import Monitor
from goldfield.view.records import json_line, number, pose_record
from goldfield_protocol.parameters import counter_name

PROTOCOL = 1
"""Version of these messages; the page says so if it was built for another."""
ROUND_POINTS = 48
"""Points that draw a round coil."""
MOST_POINTS = 256
"""Points that draw a wire, of which a survey may have thousands."""
MARGIN = 0.08
"""The box that is shown is larger than the beacons' by this part of its largest side, on each side."""

LEFT_OUT = "left out: "
"""How a pose's reason begins to say why a beacon was left out."""

Json = dict[str, Any]


def hello(site: Site, name: str, *, live: bool) -> str:
    """Return the first message to a browser: who speaks, and the site.

    Parameters
    ----------
    site : Site
    name : str
        The link's name, or the recording's.
    live : bool
        Whether it is a sensor on a link, not a recording.
    """
    low, high = site_box(site)
    half = site.half_space
    return json_line(
        {
            "type": "hello",
            "protocol": PROTOCOL,
            "source": name,
            "live": live,
            "site": {
                "name": site.name,
                "cycle_s": site.cycle_s,
                "alert_limit_m": number(site.alert_limit_m),
                "box": {"low_m": _rounded(low), "high_m": _rounded(high)},
                "half_space": half and {"point_m": half.point_m.tolist(), "normal": half.normal.tolist()},
                "beacons": [
                    {
                        "id": beacon.id,
                        "code": beacon.code,
                        "position_m": _rounded(beacon.position_m),
                        "axis": _rounded(beacon.axis),
                        "wire_m": _rounded(wire_of(beacon)),
                    }
                    for beacon in site.beacons
                ],
            },
        }
    )


def epoch_message(epoch: Epoch) -> str:
    """Return the message of an epoch: its pose, and what arrived of its cycle."""
    report = epoch.report
    sigmas = epoch.fields.sigma_T[np.isfinite(epoch.fields.sigma_T)]
    return json_line(
        {
            "type": "epoch",
            **pose_record(epoch.pose),
            "at_rate": epoch.at_rate,
            "lost": epoch.lost,
            "chips": report.chips,
            "saturated": report.saturated,
            "locked": report.locked,
            "noise_T": number(float(np.median(sigmas))) if len(sigmas) else None,
            "alarms": _alarms(epoch),
        }
    )


def fix_message(fix: Fix) -> str:
    """Return the message of a pose at a time of its own."""
    return json_line({"type": "fix", **pose_record(fix.pose)})


def health_message(monitor: Monitor, roster: Roster) -> str:
    """Return the message of the latest seconds: rates, each beacon at the sensor, and what each board says of itself.

    Parameters
    ----------
    monitor : Monitor
        It holds an epoch at least.
    roster : Roster
        What the boards on the link have said.
    """
    boards = {str(number): _board(node) for number, node in sorted(roster.nodes.items())}
    return json_line({"type": "health", **monitor.record(), "boards": boards})


def wire_of(beacon: Beacon) -> FloatArray:
    """Return a coil's wire in the site's frame, m, shape (n, 3), closed, of as many points as a picture needs."""
    if beacon.points_m is not None:
        every = math.ceil(len(beacon.points_m) / MOST_POINTS)
        return np.concatenate([beacon.points_m[::every], beacon.points_m[-1:]])
    angle = np.linspace(0.0, 2.0 * math.pi, ROUND_POINTS + 1)
    assert beacon.radius_m is not None  # a coil has points or a radius
    flat = beacon.radius_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    return np.asarray(beacon.position_m + flat @ frame(beacon.axis, 0.0).T)


def site_box(site: Site) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box that is shown, m, shape (3,) each: it holds every coil."""
    points_m = np.concatenate([wire_of(beacon) for beacon in site.beacons])
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    margin = MARGIN * max(float((high - low).max()), 0.1)
    return low - margin, high + margin


def _rounded(values: FloatArray) -> Any:
    return np.round(values, 5).tolist()


def _alarms(epoch: Epoch) -> list[Json]:
    """Return what is wrong, each once: what was found, why the pose is not worth more, and what was lost."""
    findings: list[Finding] = [*epoch.pose.findings, *epoch.findings]
    first = {(f.kind, f.beacons or f.text): f for f in reversed(findings)}  # one kind about one beacon is told once
    told = [{"kind": f.kind.value, "beacons": list(f.beacons), "text": f.text} for f in reversed(first.values())]
    reason = _unsaid(epoch.pose, findings)
    told += [{"kind": epoch.pose.status.value, "beacons": [], "text": reason}] if reason else []
    return told + [{"kind": "note", "beacons": [], "text": note} for note in epoch.notes]


def _unsaid(pose: Pose, findings: list[Finding]) -> str | None:
    """Return what a pose's reason says that no finding has said."""
    said = {finding.text for finding in findings}
    parts = (pose.reason or "").split("; ")
    return "; ".join(part for part in parts if part.removeprefix(LEFT_OUT) not in said) or None


def _board(node: Node) -> Json:
    health = node.health.get(0)
    return {
        "role": node.role,
        "state": node.state,
        "version": node.version,
        "locked": node.locked,
        "phase_s": None if node.phase_s is None else number(node.phase_s),
        "temperature_degC": None if node.temperature_degC is None else number(node.temperature_degC),
        "coil_degC": None if health is None else number(health.coil_degC),
        "driver_degC": None if health is None else number(health.driver_degC),
        "supply_V": None if health is None else number(health.supply_V),
        "complaints": [text for _, drive in sorted(node.drives.items()) for text in drive.complaints],
        "counters": {counter_name(index): count for index, count in sorted(node.counters.items()) if count},
    }

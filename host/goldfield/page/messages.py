"""The messages of the live page, as JSON: each epoch and fix, the health of the boards now and then, a progress.

`docs/live_page.md` documents every key. A message is a JSON object whose ``type`` tells what it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from goldfield.nodes.roster import Roster
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.types import Finding, Pose
from goldfield.view.boards import board_record
from goldfield.view.monitor import Monitor
from goldfield.view.records import json_line, number, pose_record

LEFT_OUT = "left out: "
"""How a pose's reason begins to say why a beacon was left out."""
MAY_BE, OR = "it may be that ", ", or that "
"""How it begins to say what might be wrong, and goes on."""

Json = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """A line of a progress: its name, what is known of it in words, and how far it is.

    Attributes
    ----------
    name, text : str
    share : float or None
        From 0 to 1, where 1 is enough; None: nobody can tell what is enough.
    """

    name: str
    text: str
    share: float | None = None


@dataclass(frozen=True)
class Progress:
    """How far a survey or a calibration is.

    Attributes
    ----------
    task : str
        ``"survey"`` or ``"calibration"``.
    text : str
        A sentence: what is being done, or what is to be done next.
    share : float or None
        How far the whole is, from 0 to 1; None: nobody can tell.
    rows : sequence of Row
        How far its parts are.
    """

    task: str
    text: str
    share: float | None = None
    rows: Sequence[Row] = ()


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
    boards = {str(number): board_record(node) for number, node in sorted(roster.nodes.items())}
    return json_line({"type": "health", **monitor.record(), "boards": boards})


def progress_message(progress: Progress) -> str:
    """Return the message of how far a survey or a calibration is."""
    return json_line(
        {
            "type": "progress",
            "task": progress.task,
            "text": progress.text,
            "share": progress.share,
            "rows": [{"name": row.name, "text": row.text, "share": row.share} for row in progress.rows],
        }
    )


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
    return "; ".join(part for part in parts if not said.issuperset(_explanations(part))) or None


def _explanations(part: str) -> list[str]:
    """Return what a part of a reason says is wrong, or may be, as findings say it."""
    return part.removeprefix(MAY_BE).split(OR) if part.startswith(MAY_BE) else [part.removeprefix(LEFT_OUT)]

"""What a run came to: poses by status, beacons that were left out, what was found, messages and counters."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from goldfield.errors import counted, listed
from goldfield.types import Explanation, Finding, FloatArray, Pose, Status
from goldfield.view.latency import Latency
from goldfield.view.terminal import WIDTH
from goldfield.view.truth import NO_ERROR, PoseError

_What = tuple[Explanation, tuple[str, ...], str]
"""What findings over a run are counted together: `_what`."""

TOLD = (Explanation.CLOCK, Explanation.BOARD)
"""Kinds of what boards say: if it is about no beacon, each sentence is another matter."""


@dataclass
class _Found:
    """What is one `_What`, over a run."""

    count: int = 0
    last: Finding | None = None
    position_m: list[FloatArray] = field(default_factory=list)
    factor: list[float] = field(default_factory=list)

    def add(self, finding: Finding) -> None:
        self.count += 1
        self.last = finding
        if finding.position_m is not None:
            self.position_m.append(finding.position_m)
        if finding.factor is not None:
            self.factor.append(finding.factor)


@dataclass
class _Said:
    """The reasons of poses of one status that no finding explains."""

    count: int = 0
    last: str = ""
    various: bool = False

    def add(self, reason: str) -> None:
        self.various |= self.count > 0 and reason != self.last
        self.last = reason
        self.count += 1


@dataclass
class Summary:
    """Counts over a run, and rms errors of the poses with status ok.

    Attributes
    ----------
    what : str
        What `add` is told of: epochs, or poses at a rate of their own.
    epochs, lost_messages : int
        Epochs or poses that `add` was told of, and messages lost in all of them.
    statuses : Counter of Status
    link : dict of str to int
        What went wrong on the way of the sensor's messages, with how often.
    counters : dict of str to int
        The sensor's own error counters.
    board_counters : dict of int to dict of str to int
        The error counters of the other boards, by node.
    dropped : dict of str to int
        Epochs and poses that each output which was too slow did not get.
    latency : Latency
        How late the lines of a live run were.
    """

    what: str = "epochs"
    epochs: int = 0
    lost_messages: int = 0
    statuses: Counter[Status] = field(default_factory=Counter)
    link: dict[str, int] = field(default_factory=dict)
    counters: dict[str, int] = field(default_factory=dict)
    board_counters: dict[int, dict[str, int]] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    latency: Latency = field(default_factory=Latency)
    _excluded: Counter[str] = field(default_factory=Counter)
    _found: dict[_What, _Found] = field(default_factory=dict)
    _reasons: dict[Status, _Said] = field(default_factory=dict)
    _position_m: list[float] = field(default_factory=list)
    _attitude_rad: list[float] = field(default_factory=list)

    def add(self, pose: Pose, error: PoseError = NO_ERROR, lost: int = 0) -> None:
        """Count an epoch."""
        self.epochs += 1
        self.lost_messages += lost
        self.statuses[pose.status] += 1
        self._excluded.update(pose.excluded if pose.used else ())
        for key, finding in {_what(finding): finding for finding in pose.findings}.items():
            self._found.setdefault(key, _Found()).add(finding)
        if pose.reason is not None and not pose.findings:
            self._reasons.setdefault(pose.status, _Said()).add(pose.reason)
        if pose.status is Status.OK and math.isfinite(error.position_m) and math.isfinite(error.attitude_rad):
            self._position_m.append(error.position_m)
            self._attitude_rad.append(error.attitude_rad)

    def text(self, truth: bool) -> str:
        """Return the summary as lines of at most 80 columns."""
        counts = [f"{self.statuses[status]} {status.value}" for status in Status if self.statuses[status]]
        lines = [f"{counted(self.epochs, self.what)}: {', '.join(counts) or 'none'}"]
        lines += self._about_beacons()
        lines += self._about_links()
        lines += [self.latency.text()] if self.latency.count else []
        position, attitude = _rms(self._position_m), _rms(self._attitude_rad)
        if position is not None and attitude is not None:
            lines.append(
                f"rms error of {counted(len(self._position_m), 'ok poses')}: position {position * 100.0:.2f} cm, "
                f"attitude {math.degrees(attitude):.2f} deg"
            )
        elif truth:
            lines.append("no ok pose could be compared with the truth")
        return "\n".join(part for line in lines for part in textwrap.wrap(line, WIDTH, subsequent_indent="  "))

    def record(self) -> dict[str, Any]:
        """Return the counts under the keys of ``goldfield run --summary``, without what never happened."""
        return {
            "epochs": self.epochs,
            "statuses": {status.value: count for status, count in self.statuses.items() if count},
            "excluded": dict(self._excluded),
            "lost": self.lost_messages,
            "link": self.link,
            "counters": self.counters,
            "board_counters": {str(node): counters for node, counters in self.board_counters.items()},
            "dropped": self.dropped,
            "position_rms_m": _rms(self._position_m),
            "attitude_rms_rad": _rms(self._attitude_rad),
            "latency": self.latency.record() if self.latency.count else None,
        }

    def _about_beacons(self) -> list[str]:
        lines: list[str] = []
        told: set[str] = set()
        for (kind, beacons, _), found in sorted(self._found.items(), key=lambda item: -item[1].count):
            left_out = [name for name in beacons if self._excluded[name] and name not in told]
            told.update(left_out)
            lines += [f"{self._left_out(name)}: {_summed_up(kind, found)}" for name in left_out]
            if not told & set(beacons):
                lines.append(f"in {found.count} of {self.epochs}: {_summed_up(kind, found)}")
        lines += [self._left_out(name) for name in self._excluded if name not in told]
        for status, said in self._reasons.items():
            example = ", such as" if said.various else ""
            lines.append(f"{status.value} in {said.count} of {self.epochs}{example}: {said.last}")
        return lines

    def _left_out(self, name: str) -> str:
        return f"{name} left out in {self._excluded[name]} of {self.epochs}"

    def _about_links(self) -> list[str]:
        counts = {"messages lost": self.lost_messages, **self.link}
        lines = [f"the link: {_counted(counts)}"] if any(counts.values()) else []
        if self.counters:
            lines.append(f"the sensor counted since its reset: {_counted(self.counters)}")
        lines += [f"node {node} counted: {_counted(counters)}" for node, counters in self.board_counters.items()]
        lines += [
            f"{counted(n, f'{self.what} were left out')} of {name}, which was too slow or not there"
            for name, n in self.dropped.items()
        ]
        return lines


def _what(finding: Finding) -> _What:
    """Return the kind of a finding and its beacons; of what a board says of none of them the sentence, too."""
    told = finding.kind in TOLD and not finding.beacons
    return finding.kind, finding.beacons, finding.text if told else ""


def _summed_up(kind: Explanation, found: _Found) -> str:
    """Return what was found in one sentence: the median over the epochs where there is a figure."""
    assert found.last is not None
    names = listed(found.last.beacons)
    if kind is Explanation.MOVED and found.position_m:
        x, y, z = np.median(found.position_m, axis=0)
        return f"its position fits better at ({x:.3f}, {y:.3f}, {z:.3f}) m"
    if kind is Explanation.CURRENT and found.factor:
        return f"the current of {names} fits better at {np.median(found.factor):.3f} of what the site says"
    return found.last.text


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(counted(count, name) for name, count in counts.items() if count)


def _rms(values: list[float]) -> float | None:
    return math.sqrt(sum(value * value for value in values) / len(values)) if values else None

"""The health of a sensor and its beacons, from the epochs of the latest seconds: as a table, a line, or a record."""

from __future__ import annotations

import math
import textwrap
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import can
import numpy as np

from goldfield.errors import counted
from goldfield.nodes.roster import Node, Roster
from goldfield.sensor.pipeline import Epoch
from goldfield.sensor.strength import Strength, Strengths, mean_strengths
from goldfield.site import Site
from goldfield.types import Status
from goldfield.view.terminal import WIDTH
from goldfield_protocol.parameters import PARAMETERS, counter_name

WINDOW_S = 2.0
"""The figures are those of so long a time, s."""
HEADER = "beacon     measured nT expected nT   ratio  resid node current A  status"
CODE, WAVEFORM = PARAMETERS["code"].first, PARAMETERS["waveform"].first


class RosterRecorder:
    """Keeps a roster of every message that a sensor's link carries; it serves as a recorder (`open_sensor`)."""

    def __init__(self) -> None:
        self.roster = Roster()

    def write(self, message: can.Message) -> None:
        """Take the next message."""
        self.roster.take(message, message.timestamp)

    def close(self) -> None:
        """Do nothing: nothing is kept outside."""


@dataclass(frozen=True)
class Beat:
    """The health of the latest seconds.

    Attributes
    ----------
    time_s : float
        The sensor's time of the latest epoch.
    cycles_per_s : float
        Epochs a second of the sensor's time; NaN before there are two.
    lost, lost_chips, saturated : int
        Messages lost, chips lost and chips saturated in the window.
    lost_in_all : int
        Messages lost since the beginning.
    locked : bool or None
        Whether the sensor's clock is locked, by its latest word.
    statuses : Counter of Status
        Poses of the window by status.
    residual : float
        Median residual of the poses.
    reason : str or None
        Why the latest pose is not worth more.
    strengths : dict of str to Strength
        Each beacon at the sensor.
    """

    time_s: float
    cycles_per_s: float
    lost: int
    lost_chips: int
    saturated: int
    lost_in_all: int
    locked: bool | None
    statuses: Counter[Status]
    residual: float
    reason: str | None
    strengths: dict[str, Strength]


class Monitor:
    """Takes epochs and tells the health of the latest of them.

    Parameters
    ----------
    site : Site
    name : str
        The link's name.
    roster : Roster
        What the boards say.
    """

    def __init__(self, site: Site, name: str, roster: Roster) -> None:
        self._site = site
        self._name = name
        self._roster = roster
        self._strengths = Strengths(site)
        self._window: deque[tuple[Epoch, dict[str, Strength]]] = deque(maxlen=max(2, round(WINDOW_S / site.cycle_s)))
        self._lost = 0
        self.node: int | None = None

    def add(self, epoch: Epoch) -> None:
        """Take the next epoch."""
        self._window.append((epoch, self._strengths.of(epoch)))
        self._lost += epoch.lost

    def beat(self) -> Beat:
        """Return the health of the window, which holds an epoch at least."""
        epochs = [epoch for epoch, _ in self._window]
        times = [epoch.report.time_s for epoch in epochs if math.isfinite(epoch.report.time_s)]
        chips = [self._site.chips - epoch.report.chips for epoch in epochs if epoch.report.chips is not None]
        locked = [epoch.report.locked for epoch in epochs if epoch.report.locked is not None]
        residuals = [epoch.pose.residual for epoch in epochs if math.isfinite(epoch.pose.residual)]
        span_s = times[-1] - times[0] if len(times) > 1 else 0.0
        return Beat(
            time_s=times[-1] if times else math.nan,
            cycles_per_s=(len(times) - 1) / span_s if span_s > 0.0 else math.nan,
            lost=sum(epoch.lost for epoch in epochs),
            lost_chips=sum(chips),
            saturated=sum(epoch.report.saturated or 0 for epoch in epochs),
            lost_in_all=self._lost,
            locked=locked[-1] if locked else None,
            statuses=Counter(epoch.pose.status for epoch in epochs),
            residual=float(np.median(residuals)) if residuals else math.nan,
            reason=epochs[-1].pose.reason,
            strengths=mean_strengths([strengths for _, strengths in self._window]),
        )

    # ---- As text ----

    def line(self) -> str:
        """Return the health as one line."""
        beat = self.beat()
        ratios = {name: one.ratio for name, one in beat.strengths.items() if math.isfinite(one.ratio)}
        worst = max(ratios, key=lambda name: abs(ratios[name] - 1.0), default=None)
        said = [
            f"{beat.time_s:.1f} s",
            f"{_figure(beat.cycles_per_s, 1)} cycles/s",
            f"{beat.lost} lost",
            _clock(beat.locked),
            _statuses(beat.statuses),
            f"residual {_figure(beat.residual, 2)}",
        ]
        said += [f"{worst} at {ratios[worst]:.2f} of the expected field"] if worst is not None else []
        return ", ".join(said) + (f": {beat.reason}" if beat.reason else "")

    def table(self) -> str:
        """Return the health as a table of at most 80 columns."""
        beat, sensor = self.beat(), self._roster.nodes.get(self.node or 0)
        phase = sensor.phase_s if sensor is not None else None
        degrees = sensor.temperature_degC if sensor is not None else None
        head = f"sensor {self.node} at {self._name}, site {self._site.name}"
        clock = _clock(beat.locked) + ("" if phase is None else f", phase {phase * 1e9:+.0f} ns")
        lines = [
            f"{head[: WIDTH - 12]:{WIDTH - 12}}{beat.time_s:10.1f} s",
            f"{_figure(beat.cycles_per_s, 1)} cycles/s; {counted(beat.lost, 'messages lost')} "
            f"({beat.lost_in_all} in all), {counted(beat.lost_chips, 'chips lost')}, {beat.saturated} saturated",
            f"clock {clock}" + ("" if degrees is None else f"; {degrees:.1f} degC"),
            f"poses: {_statuses(beat.statuses)}; residual {_figure(beat.residual, 2)}",
            HEADER,
        ]
        lines += [self._row(name, strength) for name, strength in beat.strengths.items()]
        below = [*self._counted(), *([beat.reason] if beat.reason else [])]
        return "\n".join([*lines, *(part for text in below for part in textwrap.wrap(text, WIDTH))])

    def _row(self, name: str, strength: Strength) -> str:
        board = self._board_of(name)
        current = board.drives[0].current_A if board is not None and 0 in board.drives else math.nan
        heard = math.isfinite(strength.measured_T)
        return (
            f"{name[:10]:10} {_figure(strength.measured_T * 1e9, 0):>11} {_figure(strength.expected_T * 1e9, 0):>11} "
            f"{_figure(strength.ratio, 3):>7} {_figure(strength.residual, 2):>6} {board.number if board else '-':>4} "
            f"{_figure(current, 2):>9}  {'used' if strength.used else 'left out' if heard else 'not heard'}"
        )

    def _board_of(self, name: str) -> Node | None:
        code = self._site.beacon(name).code
        found = [n for n in self._roster.nodes.values() if n.parameters.get(WAVEFORM) == 0 and n.drives]
        return next((node for node in found if node.parameters.get(CODE) == code), None)

    def _counted(self) -> Iterator[str]:
        for number, node in sorted(self._roster.nodes.items()):
            if node.counters:
                said = ", ".join(counted(count, counter_name(index)) for index, count in sorted(node.counters.items()))
                yield f"node {number} counted since its reset: {said}"

    # ---- As a record ----

    def record(self) -> dict[str, Any]:
        """Return the health for JSON, None for what is not known."""
        beat = self.beat()
        return {
            "t_s": _known(beat.time_s),
            "node": self.node,
            "cycles_per_s": _known(beat.cycles_per_s),
            "lost": beat.lost,
            "lost_in_all": beat.lost_in_all,
            "lost_chips": beat.lost_chips,
            "saturated": beat.saturated,
            "locked": beat.locked,
            "statuses": {status.value: count for status, count in beat.statuses.items()},
            "residual": _known(beat.residual),
            "reason": beat.reason,
            "beacons": {name: self._beacon_record(name, one) for name, one in beat.strengths.items()},
            "counters": {
                str(number): {counter_name(index): count for index, count in sorted(node.counters.items())}
                for number, node in sorted(self._roster.nodes.items())
                if node.counters
            },
        }

    def _beacon_record(self, name: str, strength: Strength) -> dict[str, Any]:
        board = self._board_of(name)
        return {
            "measured_T": _known(strength.measured_T),
            "expected_T": _known(strength.expected_T),
            "ratio": _known(strength.ratio),
            "residual": _known(strength.residual),
            "used": strength.used,
            "node": None if board is None else board.number,
            "current_A": board.drives[0].current_A if board is not None and 0 in board.drives else None,
        }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _figure(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "-"


def _clock(locked: bool | None) -> str:
    return {None: "unknown", True: "locked", False: "NOT locked"}[locked]


def _statuses(statuses: Counter[Status]) -> str:
    return ", ".join(f"{count} {status.value}" for status, count in statuses.most_common())

"""What a feed gets of a pose: the line that ``goldfield run`` prints, and when it was measured by the wall clock."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property

from goldfield.types import Pose, Status
from goldfield.view.lines import Line, line_record
from goldfield.view.records import json_line, number

USABLE = frozenset({Status.OK, Status.UNVERIFIED})
"""What a pose must be to be sent where a message has no room for its status: the fields fit it, and no other."""


@dataclass(frozen=True, eq=False)
class StampedPose:
    """A pose on its way to the feeds; equal to itself only.

    Attributes
    ----------
    line : Line
    unix_s : float
        When it was measured, s since 1970 (`goldfield.view.unix_time`); NaN if nothing tells it.
    live : bool
        Whether it is measured now. The poses of a recording have no latency.
    """

    line: Line
    unix_s: float
    live: bool = True

    @property
    def pose(self) -> Pose:
        """The pose itself."""
        return self.line.pose

    @property
    def usable(self) -> bool:
        """Whether a program that does not look at the status may take it: it is `USABLE`, and has a time."""
        return self.pose.status in USABLE and math.isfinite(self.unix_s)

    def latency_s(self, now_s: float) -> float:
        """Return how long ago it was measured, s; NaN if nothing tells it, or in a recording."""
        return now_s - self.unix_s if self.live else math.nan

    def json(self, now_s: float) -> str:
        """Return it as one line of JSON: the keys of ``goldfield run --json``, ``unix_s`` and ``latency_s``.

        Parameters
        ----------
        now_s : float
            The time by the wall clock, s since 1970.
        """
        return f'{self._beginning}, "latency_s": {json.dumps(number(round(self.latency_s(now_s), 6)))}}}'

    @cached_property
    def _beginning(self) -> str:
        """All of the line that is the same for every feed, without the brace at its end."""
        return json_line(line_record(self.line) | {"unix_s": number(self.unix_s)})[:-1]

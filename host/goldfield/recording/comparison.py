"""Two runs compared, pose by pose: how far apart they are, and whether they agree bit by bit."""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from goldfield.errors import counted
from goldfield.foxglove.topics import LINE
from goldfield.recording.runs import Item
from goldfield.view.records import number
from goldfield.view.truth import rotation_angle

OF_THE_RECORDING = ("unix_s", "latency_s", "position_error_m", "attitude_error_rad")
"""Keys of a line that the estimator does not make."""

Json = dict[str, Any]


@dataclass(frozen=True)
class Difference:
    """Two poses of one time.

    Attributes
    ----------
    epoch : int
    time_s : float or None
        On the sensor's clock.
    position_m, attitude_rad : float
        Distance, and angle of the rotation between the two; NaN where either pose has no place.
    deviations : float
        The distance over the standard deviation of the first pose's position; NaN if that is not known.
    statuses : tuple of str
    identical : bool
        Whether all that the estimator made of it is the same, to the last bit.
    """

    epoch: int
    time_s: float | None
    position_m: float
    attitude_rad: float
    deviations: float
    statuses: tuple[str, str]
    identical: bool

    def record(self) -> Json:
        """Return the difference for JSON."""
        return {
            "epoch": self.epoch,
            "t_s": self.time_s,
            "position_m": number(self.position_m),
            "attitude_rad": number(self.attitude_rad),
            "deviations": number(self.deviations),
            "statuses": list(self.statuses),
            "identical": self.identical,
        }


@dataclass
class Comparison:
    """What differs between two runs; feed it every `Difference`.

    Attributes
    ----------
    names : tuple of str
        What the two runs are called.
    only : list of int
        Poses that only the first run has, and only the second.
    behind : int
        Those of ``only[1]`` that are later than any of the first run: the second one has read on.
    """

    names: tuple[str, str]
    only: list[int] = field(default_factory=lambda: [0, 0])
    behind: int = 0
    common: int = 0
    identical: int = 0
    largest: Difference | None = None
    largest_rad: float = 0.0
    statuses: Counter[tuple[str, str]] = field(default_factory=Counter)
    _squares_m2: list[float] = field(default_factory=list)

    def add(self, difference: Difference) -> None:
        """Take the next pair."""
        self.common += 1
        self.identical += difference.identical
        self.statuses[difference.statuses] += 1
        if math.isfinite(difference.position_m):
            self._squares_m2.append(difference.position_m**2)
            self.largest_rad = max(self.largest_rad, difference.attitude_rad)
            if self.largest is None or difference.position_m > self.largest.position_m:
                self.largest = difference

    @property
    def same(self) -> bool:
        """Whether each pose of the first run is in the second, bit by bit, and nothing is between them."""
        return self.common > 0 and self.identical == self.common and self.only == [0, self.behind]

    @property
    def rms_m(self) -> float:
        """Root of the mean square distance; NaN if no pair has places."""
        return math.sqrt(float(np.mean(self._squares_m2))) if self._squares_m2 else math.nan

    def record(self) -> Json:
        """Return the summary for JSON."""
        return {
            "runs": list(self.names),
            "common": self.common,
            "identical": self.identical,
            "bit_identical": self.same,
            "only_first": self.only[0],
            "only_second": self.only[1],
            "behind_first": self.behind,
            "rms_m": number(self.rms_m),
            "largest": None if self.largest is None else self.largest.record(),
            "largest_attitude_rad": number(self.largest_rad),
            "statuses": {f"{a} -> {b}": count for (a, b), count in sorted(self.statuses.items()) if a != b},
        }

    def text(self) -> str:
        """Return the summary in sentences."""
        first, second = self.names
        if not self.common:
            return f"{first} and {second} have no pose of the same time: nothing can be compared"
        if self.identical == self.common:
            lines = [f"bit-identical: all {counted(self.common, 'poses that both have')}"]
        else:
            lines = [f"{self.identical} of {counted(self.common, 'poses that both have are')} bit-identical"]
        if self.largest is not None and self.identical < self.common:
            lines.append(
                f"distance: {1e3 * self.rms_m:.6g} mm rms, at most {1e3 * self.largest.position_m:.6g} mm in epoch "
                f"{self.largest.epoch} ({self.largest.deviations:.3g} standard deviations); attitude: at most "
                f"{math.degrees(self.largest_rad):.6g} deg"
            )
        changed = [(pair, count) for pair, count in sorted(self.statuses.items()) if pair[0] != pair[1]]
        lines += [f"{count} were {a} and are {b}" for (a, b), count in changed]
        between = self.only[1] - self.behind
        for count, name, where in (
            (self.only[0], first, ""),
            (between, second, ""),
            (self.behind, second, " at its end"),
        ):
            lines += [f"{counted(count, 'poses are')} only in {name}{where}"] if count else []
        return "\n".join(lines)


def differences(first: Iterable[Item], second: Iterable[Item], comparison: Comparison) -> Iterator[Difference]:
    """Yield the pairs of poses of one epoch and time, in the order of the second run, and count them.

    Parameters
    ----------
    first, second : iterable of Item
    comparison : Comparison
        It is complete at the end.
    """
    waiting: defaultdict[tuple[Any, Any], deque[Json]] = defaultdict(deque)
    latest = -math.inf
    for item in first:
        if item.topic == LINE:
            waiting[_key(item.record)].append(item.record)
            latest = max(latest, item.record["t_s"] or -math.inf)
            comparison.only[0] += 1
    for item in second:
        if item.topic != LINE:
            continue
        found = waiting.get(_key(item.record))
        if not found:
            comparison.only[1] += 1
            comparison.behind += (item.record["t_s"] or -math.inf) > latest
            continue
        comparison.only[0] -= 1
        difference = _difference(found.popleft(), item.record)
        comparison.add(difference)
        yield difference


def _key(record: Json) -> tuple[Any, Any]:
    return record["epoch"], record["t_s"]


def _difference(first: Json, second: Json) -> Difference:
    distance_m = angle_rad = deviations = math.nan
    if first["position_m"] is not None and second["position_m"] is not None:
        distance_m = math.dist(first["position_m"], second["position_m"])
        angle_rad = rotation_angle(np.array(first["orientation_xyzw"]), np.array(second["orientation_xyzw"]))
        variance_m2 = float(np.trace(first["position_cov_m2"])) if first.get("position_cov_m2") else math.nan
        deviations = distance_m / math.sqrt(variance_m2) if variance_m2 > 0.0 else math.nan
    return Difference(
        epoch=first["epoch"],
        time_s=first["t_s"],
        position_m=distance_m,
        attitude_rad=angle_rad,
        deviations=deviations,
        statuses=(first["status"], second["status"]),
        identical=_estimated(first, second),
    )


def _estimated(first: Json, second: Json) -> bool:
    """Tell whether two lines agree in every key that both have and an estimator makes; JSON keeps every bit."""
    keys = (first.keys() & second.keys()).difference(OF_THE_RECORDING)
    return all(first[key] == second[key] for key in keys)

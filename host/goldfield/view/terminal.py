"""Poses as the lines of a table, and the summary at the end."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.types import FloatArray, Pose, Status
from goldfield.view.truth import NO_ERROR, PoseError

HEADER_EVERY = 25


@dataclass
class PoseTable:
    """Makes a line of each pose; the header comes again now and then.

    Parameters
    ----------
    live : bool
        Show lost messages.
    truth : bool
        Show errors against the truth.
    """

    live: bool = False
    truth: bool = False
    _lines: int = 0

    def line(self, pose: Pose, error: PoseError = NO_ERROR, lost: int = 0, note: str = "") -> str:
        """Return the pose's line, after the header if that is due; the note comes last."""
        header = f"{self.header()}\n" if self._lines % HEADER_EVERY == 0 else ""
        self._lines += 1
        angles = np.full(3, np.nan) if pose.status is Status.FAILED else roll_pitch_yaw_deg(pose.orientation_xyzw)
        columns = [f"{pose.epoch:8d}", _cell(pose.time_s, 9, 2)]
        columns += [_cell(value, 8, 4) for value in pose.position_m]
        columns += [_cell(value, 7, 2) for value in angles]
        if self.truth:
            columns += [_cell(error.position_m * 100.0, 7, 2), _cell(math.degrees(error.attitude_rad), 7, 2)]
        columns += [f"{len(pose.used):4d}", _cell(pose.residual, 8, 2)]
        if self.live:
            columns.append(f"{lost:4d}")
        return header + " ".join(columns) + f"  {pose.status.value}{note and f', {note}'}"

    def header(self) -> str:
        """Return the line over the columns."""
        truth = f" {'err cm':>7} {'err deg':>7}" if self.truth else ""
        lost = f" {'lost':>4}" if self.live else ""
        return (
            f"{'epoch':>8} {'t s':>9} {'x m':>8} {'y m':>8} {'z m':>8} {'roll':>7} {'pitch':>7} {'yaw deg':>7}{truth}"
            f" {'used':>4} {'residual':>8}{lost}  status"
        )


@dataclass
class Summary:
    """Counts over a run, and rms errors of the poses with status ok.

    Attributes
    ----------
    epochs, ok, lost_messages : int
        Epochs that `add` was told of, those of them with status ok, and messages lost in all of them.
    bad_frames, missed_cycles : int
        Corrupt frames, and cycles lost in long gaps.
    counters : dict of str to int
        The sensor's own error counters.
    dropped : dict of str to int
        Epochs that each output which was too slow did not get.
    """

    epochs: int = 0
    ok: int = 0
    lost_messages: int = 0
    bad_frames: int = 0
    missed_cycles: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    _position_m: list[float] = field(default_factory=list)
    _attitude_rad: list[float] = field(default_factory=list)

    def add(self, pose: Pose, error: PoseError = NO_ERROR, lost: int = 0) -> None:
        """Count an epoch."""
        self.epochs += 1
        self.lost_messages += lost
        if pose.status is not Status.OK:
            return
        self.ok += 1
        if math.isfinite(error.position_m) and math.isfinite(error.attitude_rad):
            self._position_m.append(error.position_m)
            self._attitude_rad.append(error.attitude_rad)

    def text(self, truth: bool) -> str:
        """Return the summary as lines."""
        lines = [
            f"{self.epochs} epochs, {self.ok} ok; {self.lost_messages} messages lost, {self.bad_frames} corrupt "
            f"frames, {self.missed_cycles} cycles missed in gaps"
        ]
        if self.counters:
            counted = ", ".join(f"{count} {name}" for name, count in self.counters.items())
            lines.append(f"the sensor counted since its reset: {counted}")
        for name, count in self.dropped.items():
            lines.append(f"{count} epochs were left out of {name}, which took them too slowly")
        position, attitude = _rms(self._position_m), _rms(self._attitude_rad)
        if position is not None and attitude is not None:
            lines.append(
                f"rms error of {len(self._position_m)} ok poses: position {position * 100.0:.2f} cm, "
                f"attitude {math.degrees(attitude):.2f} deg"
            )
        elif truth:
            lines.append("no ok pose could be compared with the truth")
        return "\n".join(lines)


def roll_pitch_yaw_deg(orientation_xyzw: FloatArray) -> FloatArray:
    """Return roll, pitch and yaw, shape (3,), degrees, of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    r = Rotation.from_quat(orientation_xyzw).as_matrix()
    pitch = math.asin(max(-1.0, min(1.0, -r[2, 0])))
    return np.degrees([math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])])


def _cell(value: float, width: int, decimals: int) -> str:
    """Return a number in its column, a dash if there is none."""
    return f"{value:{width}.{decimals}f}" if math.isfinite(value) else f"{'-':>{width}}"


def _rms(values: list[float]) -> float | None:
    return math.sqrt(sum(value * value for value in values) / len(values)) if values else None

"""Run the commands of docs/new_room.md and draw docs/new_room.png from what they make: ``make new-room-picture``.

Left: the floor plan with the beacons as they are, as the site file has them, and as the survey finds them (errors drawn
ten times as long), and the walk. Right: the error of each pose against the truth, before and after the survey.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from tests.docs import walkthrough
from tests.docs.new_room import run_new_room

mpl.use("Agg")
import matplotlib.pyplot as plt

PICTURE = walkthrough.ROOT / "docs/new_room.png"
LONGER = 10.0
"""How much longer than the floor plan the errors of the beacons are drawn."""
COLOURS = {"before": "tab:red", "after": "tab:blue"}


def draw_floor(axes: Any, folder: Path) -> None:
    """Draw the floor plan: beacons, their errors made longer, and the walk."""
    true = walkthrough.places_m(folder / "true.toml")
    _, walk = walkthrough.located(folder / "after.jsonl", folder / "truth.jsonl")
    axes.plot(*walk[:, :2].T, color="0.8", linewidth=1, label="walk", zorder=0)
    points = np.loadtxt(folder / "points.csv", delimiter=",", skiprows=1)
    axes.plot(*np.unique(points[:, 1:3], axis=0).T, "^", color="tab:green", label="known points")
    for name, site, what in (("before", "site", "site file"), ("after", "surveyed", "surveyed")):
        wrong = walkthrough.places_m(folder / f"{site}.toml") - true
        rms_mm = 1e3 * walkthrough.beacon_rms_m(folder / f"{site}.toml", folder / "true.toml")
        # The upper beacons stand above the lower ones: each is moved aside so that both are seen.
        place = _aside(true)
        end = place + LONGER * wrong[:, :2]
        for start, stop in zip(place, end, strict=True):
            axes.plot(*np.transpose([start, stop]), color=COLOURS[name], linewidth=1)
        axes.plot(*end.T, "o", markersize=4, color=COLOURS[name], label=f"{what}: {rms_mm:.1f} mm rms")
    low = true[:, 2] < np.mean(true[:, 2])
    axes.plot(*_aside(true)[low].T, "s", markersize=6, color="black", fillstyle="none", label="true, floor")
    axes.plot(*_aside(true)[~low].T, "D", markersize=6, color="black", fillstyle="none", label="true, ceiling")
    axes.set(title=f"beacons, errors {LONGER:.0f} times as long", xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.set(xlim=(-0.75, 2.9), ylim=(-0.6, 2.75))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)


def _aside(true: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return where beacons are drawn, shape (beacons, 2): those of the ceiling 0.3 m further out along x."""
    out = np.sign(true[:, 0] - np.mean(true[:, 0])) * np.where(true[:, 2] > np.mean(true[:, 2]), 0.3, 0.0)
    return np.asarray(true[:, :2] + out[:, None] * [1.0, 0.0])


def draw_errors(axes: Any, folder: Path) -> None:
    """Draw the error of each pose, before and after."""
    for name, colour in COLOURS.items():
        ours, true = walkthrough.located(folder / f"{name}.jsonl", folder / "truth.jsonl")
        error_cm = 100.0 * np.linalg.norm(ours - true, axis=1)
        rms_cm = np.sqrt(np.mean(error_cm**2))
        axes.plot(
            np.sort(error_cm),
            np.linspace(0.0, 100.0, len(error_cm)),
            color=colour,
            label=f"{name}: {rms_cm:.2f} cm rms",
        )
    axes.set(title="position error of the poses of the walk", xlabel="error, cm", ylabel="% of the poses below")
    axes.set(xlim=(0.0, None), ylim=(0.0, 100.0))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")


def main() -> int:
    """Run the page, draw, and print what each command told last."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for step in run_new_room(folder):
            print(f"$ {step.command}", *step.printed.splitlines()[-30:], sep="\n")
        for site in ("site", "surveyed"):
            rms_m = walkthrough.beacon_rms_m(folder / f"{site}.toml", folder / "true.toml")
            print(f"{site}.toml: beacons {1e3 * rms_m:.1f} mm rms from the truth")
        figure, panels = plt.subplots(1, 2, figsize=(12, 4.6), layout="constrained", width_ratios=(3, 2))
        draw_floor(panels[0], folder)
        draw_errors(panels[1], folder)
        figure.savefig(PICTURE, dpi=100, metadata={"Software": None})
    print(f"wrote docs/{PICTURE.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

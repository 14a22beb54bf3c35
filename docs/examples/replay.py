"""Locate a recording again, epoch by epoch and tracked, and compare: ``python replay.py [LOG SITE.toml]``."""

import sys
from pathlib import Path

import numpy as np

import goldfield

HERE = Path(__file__).parent


def main(log: Path | str = HERE / "recording.log", site: Path | str = HERE / "room.toml") -> None:
    """Print how far the poses of a sensor at rest scatter."""
    for track in (False, True):
        with goldfield.open_log(log, site=site, track=track) as sensor:
            epochs = list(sensor.epochs())
        ok = [epoch.pose for epoch in epochs if epoch.pose.status is goldfield.Status.OK]
        scatter_mm = 1e3 * np.std([pose.position_m for pose in ok], axis=0)
        name = "tracked" if track else "each epoch by itself"
        print(f"{name}: {len(ok)} of {len(epochs)} ok, scatter {np.linalg.norm(scatter_mm):.2f} mm")
        for epoch in epochs:
            if epoch.lost or epoch.notes:
                print(f"epoch {epoch.pose.epoch}: {epoch.lost} messages lost; {', '.join(epoch.notes)}")


if __name__ == "__main__":
    main(*sys.argv[1:3])

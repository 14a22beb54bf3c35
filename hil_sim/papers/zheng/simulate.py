"""``goldfield paper zheng simulate``: a table of samples of a simulated room, to try survey and locate with."""

from __future__ import annotations

import argparse
import csv

from goldfield.cli.chips_file import PLACE
from goldfield.errors import UserError
from hil_sim.papers.zheng import room_options
from hil_sim.papers.zheng.columns import SAMPLES


def run(arguments: argparse.Namespace) -> int:
    """Write simulated samples."""
    room = room_options.room(arguments, 1)
    places = room.grid() if arguments.grid else room.targets(arguments.targets)
    rotation = None if arguments.tilt_deg is None else room.tilted(len(places), arguments.tilt_deg)
    samples, times = room.samples(places, rotation), room.setting.times_s()
    try:
        with open(arguments.samples, "w", encoding="utf-8", newline="") as file:  # noqa: PTH123
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(SAMPLES + PLACE)
            for window, (place, rows) in enumerate(zip(places, samples, strict=True)):
                for time_s, field in zip(times, rows, strict=True):
                    writer.writerow([window, *(repr(float(value)) for value in (time_s, *field, *place))])
    except OSError as error:
        raise UserError(f"{arguments.samples}: the samples cannot be written: {error.strerror}") from error
    print(f"{arguments.samples}: {len(places)} windows of {len(times)} samples")
    return 0

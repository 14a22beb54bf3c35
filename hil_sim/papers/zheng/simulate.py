"""``goldfield paper zheng simulate``: a table of samples of a simulated room, to try survey and locate with."""

from __future__ import annotations

import argparse
import csv
import io

from goldfield.cli.chips_file import PLACE
from goldfield.errors import counted
from goldfield.files.outputs import check_outputs, write_file
from hil_sim.papers.zheng import room_options
from hil_sim.papers.zheng.columns import SAMPLES


def run(arguments: argparse.Namespace) -> int:
    """Write simulated samples."""
    check_outputs({"SAMPLES.csv": arguments.samples}, {"--site": arguments.site}, force=arguments.force)
    room = room_options.room(arguments, 1)
    places = room.grid() if arguments.grid else room.targets(arguments.targets)
    rotation = None if arguments.tilt_deg is None else room.tilted(len(places), arguments.tilt_deg)
    samples, times = room.samples(places, rotation), room.setting.times_s()
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(SAMPLES + PLACE)
    for window, (place, rows) in enumerate(zip(places, samples, strict=True)):
        for time_s, field in zip(times, rows, strict=True):
            writer.writerow([window, *(repr(float(value)) for value in (time_s, *field, *place))])
    write_file(arguments.samples, text.getvalue().encode(), "the samples", force=arguments.force)
    print(f"{arguments.samples}: {counted(len(places), 'windows')} of {len(times)} samples")
    return 0

"""What ``goldfield run`` does: a sensor or a recording is opened, its epochs go to the sinks, a summary ends it."""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import can

from goldfield.cli import link_options
from goldfield.cli.output import json_line
from goldfield.cli.page_shown import shown
from goldfield.cli.pose_lines import PoseLines, json_record_line, table_line
from goldfield.errors import EXIT_FAILED, Loudness, counted, loudness, tell
from goldfield.feeds.address import Address
from goldfield.feeds.feed import Setting
from goldfield.feeds.opening import Feeds, open_feeds
from goldfield.files.inputs import STREAM
from goldfield.files.outputs import OutputFile
from goldfield.page.publishing import Publisher
from goldfield.recording.about import About
from goldfield.recording.formats import open_recording
from goldfield.sensor.fields_table import FieldsWriter
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import chosen_method
from goldfield.sensor.pipeline import Epoch, Fix, Sensor
from goldfield.sensor.sinks import Branch, Fanout, Part
from goldfield.site import Site
from goldfield.types import Fields
from goldfield.view.summary import Summary
from goldfield.view.truth import Truth

SWITCH_S = 1e-4
"""Longest time for which the thread that computes poses keeps the interpreter from the one that prints them, s;
Python's own 5 ms are more than a pose at 330 Hz may take. Beside a thread that computes all the time a block then takes
less than 5.0 ms of the processor in 95 of 100 cases; with 0.5 ms it was 6.4, with 5 ms 10.2."""

Item = can.Message | Epoch | Fix
"""What a recording takes."""


@dataclass(frozen=True)
class Beside:
    """What takes each item of a run beside the lines and the table: feeds, the live page, a recording."""

    feeds: Feeds
    page: Publisher | None
    recorder: Branch[Item] | None

    def write(self, item: Epoch | Fix, sensor: Sensor) -> None:
        """Hand an item to each; none of them is waited for, but for the recording of a recording."""
        self.feeds.write(item)
        if self.page is not None:
            self.page.publish(item, sensor)
        if self.recorder is not None:
            self.recorder.write(item)


def print_poses(
    arguments: argparse.Namespace, kind: str, where: str, site: Site, addresses: Sequence[Address] = ()
) -> int:
    """Print a line for every epoch of a source, and a summary however it ends.

    Parameters
    ----------
    arguments : argparse.Namespace
        The parsed command line of ``goldfield run``.
    kind, where : str
        The source, as for `open_sensor`.
    site : Site
    addresses : sequence of Address
        Where the poses go besides.

    Returns
    -------
    int
        The exit code: 0, or 3 if a feed failed, or a recording or a table could not be written to the end.
    """
    method = chosen_method(arguments.track, arguments.on_sensor, arguments.rate, arguments.lag)
    choices = link_options.reading(arguments, method)
    with contextlib.ExitStack() as stack:
        page = stack.enter_context(shown(arguments, site, where, live=kind != "log"))
        recorder = writer = None
        if arguments.record:
            about = About(f"{kind} {where}", choices, site, arguments.site, live=kind != "log")
            writer = open_recording(arguments.record, about, force=arguments.force)
            recorder = Branch(writer, arguments.record, waits=kind == "log", essential=arguments.record == STREAM)
            stack.callback(end_recording, recorder)
        summary = Summary("epochs" if arguments.rate is None and arguments.lag is None else "poses")
        if arguments.summary:
            stack.enter_context(_written_at_the_end(summary, arguments.summary, force=arguments.force))
        feeds = stack.enter_context(open_feeds(addresses, Setting(site, force=arguments.force), live=kind != "log"))
        heard = recorder if page is None else page.recorder(recorder)
        sensor = stack.enter_context(open_sensor(kind, where, site, choices, heard))
        if sensor.live:
            sys.setswitchinterval(SWITCH_S)
            gc.freeze()  # else a search for garbage looks through all that was imported, for 50 ms
        sinks = _print_epochs(arguments, sensor, summary, Beside(feeds, page, recorder))
    if sinks.stuck:
        sys.stderr.flush()
        os._exit(0)  # at its own end Python would wait for the lock of stdout, which the stuck thread has
    failed = sinks.failed or feeds.failed or (writer is not None and writer.failed)
    return EXIT_FAILED if failed else 0


def end_recording(recorder: Branch[Item]) -> None:
    """Close a recording, and tell how much of it is missing."""
    recorder.close()
    if recorder.dropped:
        tell(
            f"{recorder.name}: {counted(recorder.dropped, 'messages are missing')} in it, because the disk was too slow"
        )


@contextlib.contextmanager
def _written_at_the_end(summary: Summary, path: str, *, force: bool) -> Iterator[None]:
    """Write a summary as JSON to a file however the run ends, if there was an epoch; it must be writable before."""
    file = OutputFile(path, "the summary", force=force)
    try:
        yield
    finally:
        with file:  # a full disk leaves nothing of it
            if summary.epochs:
                file.write(f"{json_line(summary.record())}\n".encode())
            else:
                file.discard()


def _print_epochs(
    arguments: argparse.Namespace, sensor: Sensor, summary: Summary, beside: Beside
) -> Fanout[Epoch | Fix]:
    """Print the poses and the summary; return the sinks, of which an interrupt may have left one stuck."""
    sinks, ended = _sinks(arguments, sensor, summary), False
    try:
        with sinks, beside.feeds:
            for item in sensor.stream():
                sinks.write(item)
                beside.write(item, sensor)
        ended = True
    except KeyboardInterrupt:  # the usual end of a live run
        sinks.close_again()
    finally:
        summary.link = sensor.link_counts
        summary.counters = sensor.counters
        summary.board_counters = sensor.board_counters
        summary.dropped = sinks.dropped | beside.feeds.dropped
        if summary.epochs or ended:
            aside = arguments.json or sinks.stuck
            if not aside or loudness() is not Loudness.QUIET:
                text = summary.text(truth=bool(arguments.truth))
                print(text, file=sys.stderr if aside else sys.stdout, flush=True)
    return sinks


def _sinks(arguments: argparse.Namespace, sensor: Sensor, summary: Summary) -> Fanout[Epoch | Fix]:
    """Return the sinks that the command line asks for: the lines on stdout, and perhaps a table of fields."""
    truth = Truth(arguments.truth) if arguments.truth else None
    compared, at_rate = truth is not None, arguments.rate is not None or arguments.lag is not None
    line_of = json_record_line(truth=compared) if arguments.json else table_line(truth=compared, times=at_rate)
    fields = FieldsWriter(arguments.fields, force=arguments.force) if arguments.fields else None
    sinks: Fanout[Epoch | Fix] = Fanout(waits=not sensor.live)
    sinks.add(PoseLines(line_of, summary, truth, live=sensor.live), "the lines on stdout", essential=True)
    if fields is not None:
        sinks.add(Part(fields, _fields_of), arguments.fields, essential=arguments.fields == STREAM)
    return sinks


def _fields_of(item: Epoch | Fix) -> Fields | None:
    return item.fields if isinstance(item, Epoch) else None

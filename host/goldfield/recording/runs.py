"""The poses of a run, read again from a recording, or made anew of its messages by today's estimator."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

from goldfield.errors import UserError, tell
from goldfield.files.inputs import STREAM, name_of, open_input
from goldfield.files.toml_table import parse_table
from goldfield.foxglove.topics import FIELDS, LINE
from goldfield.link.buses import LogSource
from goldfield.link.mcap_records import MAGIC, Logged, McapRecords, no_topic
from goldfield.link.recordings import CandumpReader
from goldfield.recording.about import ABOUT, SITE_FILE, options_of
from goldfield.recording.line_checks import check_fields, check_line
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Epoch
from goldfield.site import Site, load
from goldfield.site.reading import site_of
from goldfield.view.lines import Lines, line_record
from goldfield.view.records import fields_record, number
from goldfield.view.unix_time import UnixTime

LONGEST_LINE = 1 << 20
"""Bytes of a line of JSON at most."""


@dataclass(frozen=True)
class Item:
    """One line of a run, or the fields of a cycle.

    Attributes
    ----------
    topic : str
        ``/goldfield/line``, with the keys of ``goldfield run --json``, or ``/goldfield/fields``.
    arrived_s : float
        When it came, by the wall clock; NaN if the run does not tell.
    record : dict
    """

    topic: str
    arrived_s: float
    record: dict[str, Any]


class Run:
    """A run, read once.

    Attributes
    ----------
    name : str
        The file, for messages.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __iter__(self) -> Iterator[Item]:
        """Yield what the run tells, in the order in which it came."""
        raise NotImplementedError

    @property
    def site(self) -> Site | None:
        """The site of the run, if it tells it; known once the first item was read."""
        return None

    @property
    def options(self) -> Options:
        """How its poses were made; known once the first item was read."""
        return Options()


class McapRun(Run):
    """The poses that an MCAP file holds.

    Parameters
    ----------
    path : path
        ``-`` is stdin.
    file : file, optional
        The same, if it is open already.

    Raises
    ------
    UserError
        If the file cannot be read; while reading, if it holds no poses. What is damaged ends it, and is told.
    """

    def __init__(self, path: str | Path, file: BinaryIO | None = None) -> None:
        super().__init__(name_of(path))
        self._file = open_input(path, "recording") if file is None else file
        self._records = McapRecords(self.name, self._file)

    def __iter__(self) -> Iterator[Item]:
        """See `Run`."""
        count = 0
        try:
            for logged in self._records:
                if logged.topic in (LINE, FIELDS):
                    record = self._record(logged)
                    count += 1
                    yield Item(logged.topic, logged.arrived_s, record)
        except UserError:
            raise
        except Exception:  # the reader raises kinds of its own at what is torn
            if count:
                tell(f"{self.name}: is damaged or was cut off: what comes before is used")
        else:
            if count and not self._records.ended:
                tell(f"{self.name}: was not ended, as when a program is killed: its last second may be missing")
        finally:
            self._file.close()
        if not count:
            raise UserError(f"{self.name}: {no_topic(self._records, 'poses')}: give a recording of goldfield run")

    def _record(self, logged: Logged) -> dict[str, Any]:
        """Return what a message holds; `UserError` if it is of another program, since damage is noticed before."""
        try:
            return (check_line if logged.topic == LINE else check_fields)(json.loads(logged.data))
        except (ValueError, RecursionError) as error:
            raise UserError(
                f"{self.name}: a message of {logged.topic} is not as goldfield run writes it: {error}"
            ) from error

    @property
    def site(self) -> Site | None:
        """See `Run`."""
        attached = self._records.attachments.get(SITE_FILE)
        if attached is None:
            return None
        text = attached.decode("utf-8", "replace")
        site = site_of(parse_table(text, f"{self.name}: {SITE_FILE}", "site file"))
        try:
            limit_m = json.loads(self._about.get("alert_limit_m", "null"))
            return replace(site, alert_limit_m=math.inf if limit_m is None else float(limit_m))
        except (ValueError, TypeError) as error:
            raise UserError(f"{self.name}: its metadata does not tell the alert limit: {error}") from error

    @property
    def options(self) -> Options:
        """See `Run`."""
        try:
            return options_of(self._about)
        except (ValueError, TypeError, AttributeError) as error:
            raise UserError(f"{self.name}: its metadata does not tell how the poses were made: {error}") from error

    @property
    def _about(self) -> Mapping[str, str]:
        return self._records.metadata.get(ABOUT, {})


class JsonRun(Run):
    """The poses of lines of JSON, as ``goldfield run --json`` and ``goldfield locate --json`` print them.

    Parameters
    ----------
    path, file
        As for `McapRun`.

    Raises
    ------
    UserError
        If the file cannot be read; while reading, if a line is no pose, but a last one that is cut off.
    """

    def __init__(self, path: str | Path, file: BinaryIO | None = None) -> None:
        super().__init__(name_of(path))
        self._file = open_input(path, "recording") if file is None else file

    def __iter__(self) -> Iterator[Item]:
        """See `Run`."""
        with self._file as file:
            for count, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), start=1):
                if not line.strip():
                    continue
                try:
                    record = check_line(json.loads(line))
                except (ValueError, RecursionError) as error:
                    if count > 1 and not line.endswith(b"\n") and len(line) < LONGEST_LINE:
                        tell(f"{self.name}:{count}: the last line is cut off: what comes before is used")
                        return
                    raise UserError(f"{self.name}:{count}: is no line of goldfield run --json: {error}") from error
                yield Item(LINE, math.nan, record)


class EstimatedRun(Run):
    """The poses that today's estimator makes of the messages of a recording, in any format.

    Parameters
    ----------
    path : path
    site : Site
    options : Options
    file : file, optional
        As for `McapRun`.

    Raises
    ------
    UserError
        While reading, as `goldfield.open_log`.
    """

    def __init__(self, path: str | Path, site: Site, options: Options, file: BinaryIO | None = None) -> None:
        super().__init__(name_of(path))
        self._path, self._site, self._options = str(path), site, options
        self._source = None if file is None else LogSource(CandumpReader(path, file))

    def __iter__(self) -> Iterator[Item]:
        """See `Run`."""
        clock, lines = UnixTime(self._site.cycle_s), Lines()
        with open_sensor("log", self._path, self._site, self._options, source=self._source) as sensor:
            for item in sensor.stream():
                unix_s = clock.unix_s(item)
                if isinstance(item, Epoch):
                    yield Item(FIELDS, item.arrived_s, fields_record(item.fields, unix_s))
                line = lines.take(item)
                if line is not None:
                    times = {"unix_s": number(unix_s), "latency_s": number(item.arrived_s - unix_s)}
                    yield Item(LINE, item.arrived_s, line_record(line) | times)

    @property
    def site(self) -> Site | None:
        """See `Run`."""
        return self._site

    @property
    def options(self) -> Options:
        """See `Run`."""
        return self._options


def open_run(path: str | Path, site_file: str | None = None, *, again: bool = False) -> Run:
    """Open the poses of a run.

    Parameters
    ----------
    path : path
        A recording in MCAP, or lines of JSON as ``goldfield run --json`` prints them, whose poses are read; or a log of
        messages in any other format, of which they are made.
    site_file : str, optional
        The site file, which a log of messages needs; for a recording in MCAP it takes the place of the attached one.
    again : bool
        Whether the poses are made of the messages of a recording in MCAP, too, as the run made them.

    Raises
    ------
    UserError
        If the file cannot be read, or a site file is needed, or what must be read twice is a stream.
    """
    file = open_input(path, "recording")
    head = file.peek(len(MAGIC))[: len(MAGIC)] if hasattr(file, "peek") else b""
    if head.startswith(MAGIC) and not again:
        return McapRun(path, file)
    if head.startswith(MAGIC):
        whole = str(path) != STREAM and file.seekable()
        file.close()
        if not whole:
            raise UserError(f"{name_of(path)}: is read twice to make its poses again: save it as a file first")
        return estimated(path, site_file)
    if head.lstrip().startswith(b"{"):
        if again:
            file.close()
            raise UserError(f"{name_of(path)}: holds poses and no messages: nothing can be made of it again")
        return JsonRun(path, file)
    if not head:
        file.close()
        raise UserError(f"{name_of(path)}: is empty: give a recording")
    if site_file is None:
        file.close()
        raise UserError(f"{name_of(path)}: holds no poses: give --site FILE, with which they are made of its messages")
    return EstimatedRun(path, load(site_file), Options(), file)


def estimated(path: str | Path, site_file: str | None = None) -> EstimatedRun:
    """Return the run that today's estimator makes of a recording in MCAP, with its site and its options.

    Raises
    ------
    UserError
        If the file cannot be read or tells no site, and no site file is given.
    """
    told = McapRun(path)
    next(iter(told), None)
    site = told.site if site_file is None else load(site_file)
    if site is None:
        raise UserError(f"{told.name}: has no site file attached: give --site FILE")
    return EstimatedRun(path, site, told.options)

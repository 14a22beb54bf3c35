"""The pipeline: a source of messages and a site in, poses with everything known about them out."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

from goldfield.errors import UserError, counted
from goldfield.link.buses import BusSource, Source
from goldfield.link.reports import Report
from goldfield.sensor.amendment import amended_fields, amended_pose
from goldfield.sensor.anchors import left_out
from goldfield.sensor.awaiting import until_heard
from goldfield.sensor.between import Between
from goldfield.sensor.location import Succession, location, needed_parameters, with_finding, without
from goldfield.sensor.options import Method, Options
from goldfield.sensor.receiver import Recorder
from goldfield.sensor.recorded_cycle import RecordedCycle
from goldfield.sensor.separation import Separation
from goldfield.sensor.session import Event, Session
from goldfield.sensor.strangers import Strangers
from goldfield.sensor.verdict import Verdict, judge
from goldfield.site import Site
from goldfield.types import Explanation, Fields, Finding, Pose
from goldfield_protocol.parameters import counter_name

CYCLES_AT_ONCE = 3
"""Cycles whose reports may come in a row, where a sensor restarts, although its blocks come all the time."""


@dataclass(frozen=True, eq=False)
class Epoch:
    """A pose with everything known about it.

    Attributes
    ----------
    pose : Pose
    fields : Fields
        The separated fields, from which the host located (unless the sensor did): without those of beacons whose
        boards report a fault, and as they would be with the site's currents where the boards measure others.
    report : Report
        What arrived of the cycle, before separation.
    lost : int
        Messages of the cycle that did not arrive.
    notes : tuple of str
        What the sensor says was wrong with the cycle, as "not synchronised" or "3 chips lost"; empty: nothing.
    findings : tuple of Finding
        What the boards on the link say of themselves, as far as it is not as it should be; they are in the pose, too.
    arrived_s : float
        Time of the wall clock at which the message that ended the cycle arrived, in a recording that which it tells.
    at_rate : bool
        Whether poses come at times of their own, each as a `Fix`: that of the epoch is then none of them.
    taken_cpu_s : float
        Processor time of this process when it took that message; NaN in a recording.
    """

    pose: Pose
    fields: Fields
    report: Report
    lost: int
    notes: tuple[str, ...]
    findings: tuple[Finding, ...] = ()
    arrived_s: float = math.nan
    at_rate: bool = False
    taken_cpu_s: float = math.nan


@dataclass(frozen=True, eq=False)
class Fix:
    """A pose at a time of its own, as they come if a rate or a lag was asked for.

    Attributes
    ----------
    pose : Pose
        Its ``time_s`` is the time for which it is valid, on the sensor's clock.
    arrived_s : float
        Time of the wall clock at which the message arrived that made it due, in a recording that which it tells.
    taken_cpu_s : float
        Processor time of this process when it took that message; NaN in a recording.
    """

    pose: Pose
    arrived_s: float
    taken_cpu_s: float = math.nan


class Sensor:
    """A sensor on a site: its epochs and poses, live or from a recording.

    `goldfield.connect` and `goldfield.open_log` make it; as a context manager it lets go of its link at the end.

    Parameters
    ----------
    source : Source
        Where the messages come from; it is closed by `close`, and if the constructor raises.
    name : str
        The link's name, for error messages.
    site : Site
    options : Options, optional
    recorder : Recorder, optional
        Gets every message received; the caller closes it.

    Attributes
    ----------
    site : Site
    name : str

    Raises
    ------
    UserError
        If the site's codes cannot be separated, there are several sensors to choose from, or a live sensor does not
        suit or speaks another protocol.
    SystemFailure
        If no live sensor is heard, or it does not answer, and is not waited for (`Options.awaits`).
    """

    def __init__(
        self,
        source: Source,
        name: str,
        site: Site,
        options: Options | None = None,
        recorder: Recorder | None = None,
    ) -> None:
        self.site = site
        self.name = name
        self._source = source
        self._found = False
        self._options = Options() if options is None else options
        method = self._options.method
        # Nobody waits for the next pose of a recording: a second thread would only cost time.
        self._aside = ThreadPoolExecutor(1, "judge") if isinstance(source, BusSource) else None
        self._between = _between(site, self._options, self._aside)
        self._in_a_row = 0 if self._between is not None and self._between.takes_poses else CYCLES_AT_ONCE
        """Cycles since the latest block or pose of a block; at the begin so many that the first one without tells. A
        sensor begins its own track with the first cycle that it locates."""
        self._session = Session(
            source,
            name,
            site,
            self._options.node,
            recorder,
            on_sensor=method is method.ON_SENSOR and self._between is None,
            channel=self._options.channel,
            blocks=self._between is not None and self._between.takes_blocks,
            poses=self._between is not None and self._between.takes_poses,
            strongest=self._options.strongest,
        )
        self._strangers = Strangers(site, self._session.receiver.tell_once)
        try:
            self._separation = Separation(site, of_instants=method is Method.EACH)
            self._succession = Succession()
            self._locate = location(site, method, self._succession)
            if self._session.live:
                needed = needed_parameters(site, self._options, blocks=self._session.block_parameters)
                until_heard(lambda: self._session.start(needed), awaits=self._options.awaits)
        except BaseException:
            source.close()
            raise

    def poses(self) -> Iterator[Pose]:
        """Yield a pose for every code cycle, or at the rate that was asked for, to a recording's end or without end.

        A cycle that cannot be located has a pose too, with the status ``failed``. A pose is valid for its ``time_s``;
        at a rate each is out as soon as the messages are there that it is made of; of a live sensor those that were not
        asked for in time are left out (`goldfield.sensor.backlog`). A second iterator goes on where the
        first stopped; at the end of a recording it yields nothing. The errors are those of `stream`.
        """
        return (item.pose for item in self.stream() if isinstance(item, Fix) or not item.at_rate)

    def epochs(self) -> Iterator[Epoch]:
        """Yield every code cycle as an `Epoch`, to the end of a recording or without end; the errors are `stream`'s.

        Its pose is that of the middle of the cycle where it is located by itself, and that of its end where the sensor
        is tracked by blocks.
        """
        return (item for item in self.stream() if isinstance(item, Epoch))

    def pose_at(self, time_s: float) -> Pose | None:
        """Return the pose at a time on the sensor's clock near that of the latest block, now or a little ahead.

        It has the uncertainty that the motion since then adds. None if no block has come, or the sensor is not tracked.
        """
        return None if self._between is None else self._between.pose_at(time_s)

    def stream(self) -> Iterator[Epoch | Fix]:
        """Yield every code cycle as an `Epoch` and, with a rate or a lag, every pose as a `Fix`, as they come.

        Raises
        ------
        SystemFailure
            If a live link is lost, or the sensor silent for 10 s.
        UserError
            If the sensor speaks another protocol, a recording holds no cycle of a sensor or several sensors to choose
            from, or the sensor was closed.
        """
        for event in self._events():
            if isinstance(event, Report):
                self._found = True
                yield self._epoch(event)
            elif self._between is not None:
                self._in_a_row = 0
                receiver = self._session.receiver
                arrived_s, taken_cpu_s = receiver.arrived_s, receiver.taken_cpu_s
                if self._session.backlog.broke():
                    self._between.skip()
                yield from (Fix(pose, arrived_s, taken_cpu_s) for pose in self._between.poses(event))
        if self._between is not None:
            yield from (Fix(pose, math.nan) for pose in self._between.finish())
        if not self._found and not self.live:
            others = self._session.unchosen
            chosen = f"the sensor that was chosen, but of {others}" if others else "a sensor"
            raise UserError(f"{self.name}: holds no cycle of {chosen}")

    def fields(self) -> Iterator[Fields]:
        """Yield the separated fields of each code cycle, not located, with no cycle that anybody calls wrong.

        They are those of `Epoch`: without beacons whose boards report a fault, at the site's currents. The errors are
        those of `epochs`.
        """
        for report in self.reports():
            self._found = True
            verdict, fields = self._judged(report)
            if len(fields.beacons) and not any(_notes(report, verdict, self.site.chips)):
                yield fields

    def reports(self) -> Iterator[Report]:
        """Yield what arrived of each code cycle, neither separated nor located; otherwise as `epochs`."""
        return (event for event in self._events() if isinstance(event, Report))

    def _events(self) -> Iterator[Event]:
        """Yield what arrived of each code cycle, and what comes between the cycles, as it becomes whole."""
        first = latest = math.nan
        recorded = None if self.live else RecordedCycle(self.name, self.site)
        for report in self._session.events():
            if not isinstance(report, Report):
                yield report
                continue
            if recorded is not None:
                recorded.check(report)
            yield report
            if math.isnan(first):
                first = report.time_s
            elif report.time_s < latest:  # the sensor's clock began again
                first += report.time_s - latest - self.site.cycle_s
            latest = latest if math.isnan(report.time_s) else report.time_s
            seconds = self._options.seconds
            # To the nearest cycle; the first one counts.
            if seconds is not None and report.time_s - first >= seconds - 1.5 * self.site.cycle_s:
                return

    def close(self) -> None:
        """Let go of the link."""
        self._session.end()
        self._source.close()
        if self._aside is not None:
            self._aside.shutdown(wait=False, cancel_futures=True)

    def __enter__(self) -> Self:
        """Return the sensor itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let go of the link."""
        self.close()

    @property
    def live(self) -> bool:
        """Whether this is a sensor on a link, not a recording."""
        return self._session.live

    @property
    def gone(self) -> str:
        """Why the link is gone, while it is waited for; else empty. Other threads may look at it."""
        return self._session.gone

    @property
    def node(self) -> int | None:
        """The sensor's node; None while a recording has not told it."""
        return self._session.node

    @property
    def bad_frames(self) -> int:
        """Frames so far that were dropped as damaged: corrupt, unreadable, of a wrong length or without a meaning."""
        return self._session.receiver.bad_frames

    @property
    def missed_cycles(self) -> int:
        """Cycles so far that were lost in gaps too long to make an epoch of each."""
        return self._session.assembler.missed_cycles

    @property
    def repeated(self) -> int:
        """Messages so far that had arrived already."""
        return self._session.assembler.repeated

    @property
    def late(self) -> int:
        """Messages so far that arrived after their epoch."""
        return self._session.assembler.late

    @property
    def orphans(self) -> int:
        """Messages so far whose cycle nobody can tell: before the first header or after a silence."""
        return self._session.assembler.orphans

    @property
    def restarts(self) -> int:
        """Times so far that the number of the cycle jumped: the sensor or the sync master restarted."""
        return self._session.assembler.restarts

    @property
    def counters(self) -> dict[str, int]:
        """The sensor's own error counters since its reset by name, those that are not zero."""
        return {counter_name(number): count for number, count in sorted(self._session.counters.items()) if count}

    @property
    def link_counts(self) -> dict[str, int]:
        """What else came over the link, and what went wrong on the way, with how often; what never did is left out."""
        counts = {
            **self._session.receiver.traffic,
            "cycles missed in gaps": self.missed_cycles,
            "messages that came twice": self.repeated,
            "messages that came after their epoch": self.late,
            "messages of unknown cycles": self.orphans,
            "jumps of the cycle's number": self.restarts,
            "parameters put back that another host had set": self._session.keeping.changes,
            "messages left out, because this machine fell behind": self._session.backlog.let_go,
            "blocks of chips lost": 0 if self._session.blocks is None else self._session.blocks.lost,
        }
        return {name: count for name, count in counts.items() if count}

    @property
    def board_counters(self) -> dict[int, dict[str, int]]:
        """The error counters of every other board on the link since its reset, by node and name, without zeros."""
        boards = self._session.health.counters
        return {
            node: {counter_name(number): count for number, count in sorted(counts.items())}
            for node, counts in boards.items()
            if node != self.node
        }

    def _judged(self, report: Report) -> tuple[Verdict, Fields]:
        """Return what the boards say of a cycle, and its fields with that in them."""
        strongest = self._session.strongest
        if strongest:
            self._strangers.take(report)
        verdict = judge(self._session.health, report, self.site, chosen=strongest > 0)
        return verdict, amended_fields(self._separation.fields(report, strongest), verdict)

    def _epoch(self, report: Report) -> Epoch:
        verdict, fields = self._judged(report)
        witnessed = _unexplained(self._session.anchors.finding, verdict)
        named = left_out(witnessed)
        pose, at_rate = None, False
        if self._between is not None:
            self._between.note(verdict, witnessed)
            pose = self._between.of_cycle(report)
            asked = self._options.rate_hz is not None or self._options.lag_s is not None
            at_rate = asked and self._between.follows(report)
            self._in_a_row += 1
            absent = self._in_a_row > CYCLES_AT_ONCE and not self._session.backlog.let_go
            if asked and not at_rate and absent:
                self._session.receiver.tell_once(self._between.absent)
        pose = self._succession.follow(pose) if pose is not None else self._locate(without(fields, named), report)
        missing = tuple(name for name in named if name in fields.beacons and name not in pose.excluded)
        pose = replace(pose, excluded=(*pose.excluded, *missing)) if missing else pose
        pose = with_finding(pose, witnessed)
        return Epoch(
            pose=amended_pose(pose, verdict, used_all=self._options.method is Method.ON_SENSOR),
            fields=fields,
            report=report,
            lost=report.lost(expected_fields=0 if self._session.strongest else len(self.site.codes)),
            notes=tuple(_notes(report, verdict, self.site.chips)),
            findings=verdict.findings,
            arrived_s=self._session.receiver.arrived_s,
            at_rate=at_rate,
            taken_cpu_s=self._session.receiver.taken_cpu_s,
        )


def _between(site: Site, options: Options, aside: Executor | None) -> Between | None:
    """Return what makes poses between the cycles; None if nobody asked for any."""
    if options.method is Method.EACH:
        return None
    from goldfield.sensor.tracking import between_of  # long to import: only when a sensor is tracked

    return between_of(site, options, aside)


def rehearse(site: Site, options: Options) -> None:
    """Use once what makes poses between the cycles, so that the first ones of a live sensor need not wait for it."""
    if options.method is Method.TRACK:
        from goldfield.track.blocks.rehearsal import rehearse as track  # long to import

        track(site)


def _unexplained(finding: Finding | None, verdict: Verdict) -> Finding | None:
    """Return what anchors see, unless it is a current that the board measures: that is in the fields already."""
    if finding is not None and finding.kind is Explanation.CURRENT and set(finding.beacons) <= verdict.ratio.keys():
        return None
    return finding


def _notes(report: Report, verdict: Verdict, chips: int) -> Iterator[str]:
    """Say what the boards say was wrong with the cycle."""
    yield from verdict.notes
    if report.locked is False:
        yield "not synchronised"
    if report.chips is not None and report.chips < chips:
        yield counted(chips - report.chips, "chips lost")
    if report.saturated:
        yield counted(report.saturated, "chips saturated")

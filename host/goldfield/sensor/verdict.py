"""What the boards say of themselves, as it counts for one epoch: beacons left out, currents, doubts, and sentences.

Nothing here makes a pose better than its fields make it. Times are those of the sensor's reports (`Health`).

The clock of a sensor that has lost the sync signal goes on as it last went, its drift with it. The firmware calls it
locked until the drift that it has learnt could move it by half a microsecond, and at most 100 sync periods (10 s;
``firmware/core/timing/chip_clock.h``); a longer hold-over is not promised. A report that is not locked is so beyond
hold-over by the board's own word, and its pose is inconsistent at once. During hold-over a pose keeps its status; only
on CAN, where SYNC is heard, can the hold-over be told.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from goldfield.errors import listed
from goldfield.link.heartbeat import DRIVING, STATE_CLOCK_FALLBACK, STATE_FAULT
from goldfield.link.reports import Report
from goldfield.sensor.health import Board, Drive, Health
from goldfield.site import Site
from goldfield.types import Explanation, Finding

SILENT_S = 2.5
"""A board that was not heard for so long is silent: it has missed two heartbeats, and a beacon 25 reports besides."""
HEARD_S = 0.5
"""A board that was heard within so short a time is there; a `DRIVE_STATUS` of such an age tells the current of now."""
EVENT_S = 3.0
"""How long a second master, or a second board of one number, counts after it was last heard."""
JUMP_S = 1.0
"""How long a restart, or a jump of the cycles' numbers, is told."""
SYNC_MISSED_S = 0.5
"""So long after the last SYNC, of which ten come in a second, the clocks are in hold-over."""
STEADY = 0.02
"""A current that changes by a larger share from one sync period to the next has no one value in a cycle."""
CURRENT_TOLD = 0.02
"""A current that differs by a larger share from the site's is told."""
CURRENT_USED = 0.002
"""A current that differs by a smaller share is taken as the site's: the reports scatter by so much."""
CURRENT_NONE = 0.01
"""A current that is a smaller share of the site's is none: its field says nothing, or its measurement does not."""


@dataclass(frozen=True)
class Verdict:
    """What the boards' words mean for one epoch.

    Attributes
    ----------
    out : tuple of str
        Ids of the beacons whose fields do not count.
    ratio : mapping of str to float
        Measured current over the site's, positive, of the beacons where they differ.
    findings : tuple of Finding
        What is told, the gravest first.
    inconsistent : bool
        Whether no pose of this epoch can be relied on.
    notes : tuple of str
        What is worth a few words only.
    """

    out: tuple[str, ...] = ()
    ratio: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    inconsistent: bool = False
    notes: tuple[str, ...] = ()


def judge(health: Health, report: Report, site: Site, *, chosen: bool = False) -> Verdict:
    """Return what the boards' words, up to now, mean for the epoch that is handed out now.

    Parameters
    ----------
    health : Health
    report : Report
        The sensor's report of the epoch.
    site : Site
        Its beacons have a plain code each, as `Site.codes` demands.
    chosen : bool, optional
        Whether the sensor chooses the codes that it reports: they need not be the site's.
    """
    grave = list(_of_time(health, report))
    known = _known(health, site)
    beacons = [_of_beacon(health, one) for one in known]
    findings = [*grave, *_complaints(health, known), *(finding for one in beacons for finding in one.findings)]
    findings += [*_of_wire(health), *_of_sensor(health, report, site, chosen), *_of_others(health, site)]
    holds_over = bool(health.masters) and health.now_s - max(health.masters.values()) > SYNC_MISSED_S
    return Verdict(
        out=tuple(name for one in beacons for name in one.out),
        ratio={name: ratio for one in beacons for name, ratio in one.ratio.items()},
        findings=tuple(findings),
        inconsistent=bool(grave),
        notes=("no SYNC, clocks in hold-over",) if holds_over else (),
    )


# ---- The time, and the sensor ----


def _of_time(health: Health, report: Report) -> Iterator[Finding]:
    """Yield what forbids to rely on any pose of the epoch."""
    sensor = health.boards.get(health.node or 0)
    masters = [node for node, until_s in sorted(health.rivals.items()) if health.now_s - until_s < EVENT_S]
    if masters:
        yield _clock(f"nodes {listed(masters)} are both sync masters: set sync_master = 1 in one board only")
    if sensor is None:
        return
    name = f"sensor {sensor.node}"
    if _within(health, sensor.doubled_s, EVENT_S):
        yield _clock(
            f"cycles of {name} come twice and differently: two boards have the number {sensor.node}, or two sync "
            "masters number its cycles"
        )
    if report.locked is False or (report.locked is None and sensor.locked is False):
        yield _clock(f"the clock of {name} is not locked: check its sync wire or bus, and the sync master")
    if _within(health, sensor.renumbered_s, JUMP_S):
        yield _clock(f"the numbers of the cycles of {name} jumped: the sync master restarted, or there are two")
    if sensor.state == STATE_CLOCK_FALLBACK:
        yield _clock(f"{name} runs without its crystal: replace the board")


def _of_wire(health: Health) -> Iterator[Finding]:
    """Yield who finds edges on the sync wire that are not its master's: the only trace of a second one without CAN."""
    nodes = [node for node, board in sorted(health.boards.items()) if _within(health, board.disturbed_s, EVENT_S)]
    if nodes:
        yield _clock(
            f"edges of the sync wire come at wrong times all along, as node {listed(nodes)} counts: set "
            "sync_master = 1 in one board only, or look for what disturbs the wire"
        )


def _of_sensor(health: Health, report: Report, site: Site, chosen: bool) -> Iterator[Finding]:
    """Yield what is only told of the sensor."""
    sensor = health.boards.get(health.node or 0)
    if sensor is not None and _within(health, sensor.restarted_s, JUMP_S):
        yield _board((), f"sensor {sensor.node} restarted: check its power")
    if chosen:
        return
    foreign = sorted(set(report.correlation_T) - set(site.codes))
    if foreign:
        yield _board((), f"the sensor reports code {foreign[0]}, which the site has not: check the site and the sensor")
    elif report.announced is not None and report.announced < len(site.codes):
        missing = tuple(b.id for b in site.beacons if b.code not in report.correlation_T)
        yield _board(
            missing,
            f"the sensor reports {report.announced} of the site's {len(site.codes)} codes: its code list was changed",
        )


# ---- Beacons ----


@dataclass(frozen=True)
class _Known:
    """What is known of a beacon: its current in the site file, the boards that drive its code, and who has that code.

    Where beacons share a code (``shared_codes``) it is not known which of the boards is whose.
    """

    name: str
    current_A: float
    boards: list[Board]
    users: tuple[str, ...]


def _known(health: Health, site: Site) -> list[_Known]:
    by_code: dict[int, list[Board]] = {}
    for board in health.boards.values():
        if board.role in DRIVING and board.code is not None:
            by_code.setdefault(board.code, []).append(board)
    users: dict[int, tuple[str, ...]] = {}
    for beacon in site.beacons:
        users[beacon.code] = (*users.get(beacon.code, ()), beacon.id)
    return [_Known(b.id, b.current_A, by_code.get(b.code, []), users[b.code]) for b in site.beacons]


def _of_beacon(health: Health, known: _Known) -> Verdict:
    """Return what the boards of one beacon say of it."""
    name, site_A, boards = known.name, known.current_A, known.boards
    if not boards:
        return Verdict()
    if len(boards) > len(known.users):
        nodes = listed(sorted(board.node for board in boards))
        both = "both" if len(boards) == 2 else "all"
        text = f"nodes {nodes} {both} have the code of {listed(known.users)}: give each board its own code"
        return Verdict(out=(name,), findings=(_board((name,), text),) if name == known.users[0] else ())
    if len(known.users) > 1:  # One of the boards is its own: what any complains of may be true of it.
        return Verdict(out=(name,) if any(_complaint(board) is not None for board in boards) else ())
    (board,) = boards
    if health.now_s - board.heard_s > SILENT_S:
        text = f"{name}'s board (node {board.node}) is silent: check its power and its cable"
        out = () if _complaint(board) is None else (name,)  # what it said last still holds
        return Verdict(out, findings=(_board((name,), text),))
    if _complaint(board) is not None:  # `_complaints` tells it
        return Verdict(out=(name,))
    drive = board.drive
    if drive is None or health.now_s - drive.time_s > HEARD_S:
        return Verdict()
    ratio = abs(drive.current_A / site_A)
    if abs(ratio - 1.0) <= CURRENT_USED:
        return Verdict()
    findings: tuple[Finding, ...] = ()
    if ratio < CURRENT_NONE:
        text = (
            f"{name}'s board (node {board.node}) is to drive {abs(drive.target_A):g} A and measures none: check its "
            "coil and its cable"
        )
        return Verdict(out=(name,), findings=(_board((name,), text, factor=0.0),))
    if abs(ratio - 1.0) > CURRENT_TOLD:
        text = (
            f"{name}'s board (node {board.node}) measures another current than the site's {abs(site_A):g} A, by "
            f"{100.0 * (ratio - 1.0):+.0f} %: the measured one is used"
        )
        findings = (_board((name,), text, factor=ratio),)
    return Verdict(ratio={name: ratio}, findings=findings)


def _complaints(health: Health, beacons: Iterable[_Known]) -> Iterator[Finding]:
    """Yield what the boards of beacons complain of, each complaint once, with all who have it."""
    who: dict[str, list[tuple[tuple[str, ...], int]]] = {}
    for known in beacons:
        if known.name != known.users[0] or len(known.boards) > len(known.users):
            continue
        for board in known.boards:
            complaint = _complaint(board)
            if complaint is not None and health.now_s - board.heard_s <= SILENT_S:
                who.setdefault(complaint, []).append((known.users, board.node))
    for complaint, told in who.items():
        names = [" or ".join(users) for users, _ in told]
        if len(told) == 1:
            text = f"{names[0]}'s board (node {told[0][1]}) reports {complaint}"
        else:
            text = f"the boards of {listed(names)} report {complaint}"
        yield _board(tuple(dict.fromkeys(name for users, _ in told for name in users)), text)


def _complaint(board: Board) -> str | None:
    """Return what a beacon's board reports for which its field does not count, and what to do; None if it counts."""
    drive = board.drive
    if drive is not None:
        for fault, text in (
            (drive.open_coil, "an open coil: check coil and cable, then goldfield nodes clear"),
            (drive.over_current, "over-current: look for a short in coil and cable, then goldfield nodes clear"),
            (drive.driver_fault, "a driver fault: check supply and coil, then goldfield nodes clear"),
            (not drive.locked, "a clock that is not locked: check the sync wire or the CAN bus, and the sync master"),
            (
                drive.target_A == 0.0,
                "an amplitude of 0 A: give it one with goldfield nodes set, or start it with goldfield nodes start",
            ),
            (not drive.enabled, "a bridge that is off: goldfield doctor tells why"),
            (not _steady(drive, board.drive_before), "a current that is changing"),
        ):
            if fault:
                return text
    if board.state == STATE_CLOCK_FALLBACK:
        return "a clock without its crystal: repair the board"
    return "a fault: goldfield nodes tells which" if board.state == STATE_FAULT and drive is None else None


def _steady(drive: Drive, before: Drive | None) -> bool:
    return before is None or abs(drive.current_A - before.current_A) <= STEADY * abs(drive.current_A)


def _of_others(health: Health, site: Site) -> Iterator[Finding]:
    """Yield what boards say of which it is not known which beacon of the site they are, and beacons without a board."""
    driving = [board for _, board in sorted(health.boards.items()) if board.role in DRIVING]
    codes = {board.code for board in driving}
    for board in driving:
        complaint = _complaint(board)
        if board.unasked and complaint is not None and health.now_s - board.heard_s <= SILENT_S:
            yield _board((), f"node {board.node}, a beacon, reports {complaint}")
        if _within(health, board.doubled_s, EVENT_S) and board.node != health.node:
            yield _board((), f"two boards have the number {board.node}, or its code was changed")
    untold = any(board.unasked for board in driving)  # a board that has yet to tell its code may be any beacon's
    if health.now_s > SILENT_S and not untold and any(code in site.codes for code in codes):
        for beacon in site.beacons:
            if beacon.code not in codes:
                yield _board((beacon.id,), f"no board with the code of {beacon.id} is heard: check its power and cable")


# ---- Words ----


def _within(health: Health, event_s: float | None, duration_s: float) -> bool:
    return event_s is not None and health.now_s - event_s < duration_s


def _clock(text: str) -> Finding:
    return Finding(Explanation.CLOCK, (), text)


def _board(beacons: tuple[str, ...], text: str, factor: float | None = None) -> Finding:
    return Finding(Explanation.BOARD, beacons, text, factor=factor)

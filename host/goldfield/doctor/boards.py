"""The boards, by what they say of themselves: firmware, numbers, sync master, clocks, codes, coils and currents."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from goldfield.doctor.checks import Check, Fault, sound, unjudged, wrong
from goldfield.errors import counted, listed
from goldfield.nodes.roster import UNLOCKED, Node, Roster
from goldfield.site import Beacon, Site
from goldfield_protocol.messages import protocol_hash
from goldfield_protocol.parameters import PARAMETERS

ASKED = tuple(PARAMETERS[name].first for name in ("code", "waveform", "sync_master", "degree", "armed", "amplitude"))
CODE, WAVEFORM, SYNC_MASTER, DEGREE, ARMED, AMPLITUDE = ASKED
"""Parameters that every board is asked for."""
ONE_CODE = 0
"""Value of ``waveform`` with which a board drives the one code of its parameter ``code``."""
CURRENT_TOLERANCE = 0.02
"""Largest share by which a current may differ from the site's and is used without a word: as for `goldfield run`."""


def firmware(roster: Roster) -> Iterator[Check]:
    """Yield boards that speak another protocol, and numbers that two boards have."""
    nodes = in_order(roster)
    strangers = [node for node in nodes if not node.same_protocol]
    for node in strangers:
        yield wrong(
            Fault.FIRMWARE,
            "firmware",
            f"node {node.number} ({node.role}, firmware {node.version}) speaks protocol {node.protocol:#010x} and this "
            f"host {protocol_hash():#010x}",
            f"flash it with the firmware of this host's version: make flash ROLE={node.role or 'sensor'} "
            f"NODE={node.number}",
            nodes=(node.number,),
        )
    for node in nodes:
        if node.contradictions or len(node.unique_ids) > 1:
            yield wrong(
                Fault.NUMBERS,
                "numbers",
                f"two boards have the number {node.number}",
                f"give one of them another number: unplug the other, then goldfield nodes set {node.number} node N",
                nodes=(node.number,),
            )
    if not strangers:
        versions = sorted({node.version for node in nodes if node.version is not None})
        yield sound("firmware", f"version {', '.join(versions)}, of this host's protocol")


def timing(roster: Roster, *, whole_bus: bool) -> Iterator[Check]:
    """Yield what is wrong with the clocks; who is the master is known only where every board is heard.

    A board is one by its sync signals or by its parameter, which it reads at its start.
    """
    nodes = [node for node in in_order(roster) if node.same_protocol]
    lead = [node.number for node in nodes if node.syncs]
    first = [node.number for node in nodes if node.parameters.get(SYNC_MASTER) == 1]
    masters = lead if len(lead) > 1 or len(first) < 2 else first  # A master may follow its deputy.
    masters = masters or first
    if len(masters) > 1:
        yield wrong(
            Fault.MASTERS,
            "sync master",
            f"nodes {listed(masters)} are both sync masters"
            if len(masters) == 2
            else f"{listed(masters)} are sync masters",
            "set sync_master = 0 in the page of all but one: make flash ROLE=beacon NODE=... SYNC_MASTER=0",
            nodes=tuple(masters),
        )
    elif whole_bus and not masters and any(node.drives_coils for node in nodes):
        yield wrong(
            Fault.MASTERS,
            "sync master",
            "no board is the sync master",
            "power the board that is, or make one: make flash ROLE=beacon NODE=... SYNC_MASTER=1",
        )
    elif masters:
        yield sound("sync master", f"node {masters[0]}")
    for node in nodes:
        yield from _clock(node)
    if not any(node.locked is False or node.state == "clock_fallback" for node in nodes):
        yield sound("clocks", "every clock that was heard of is locked")


def _clock(node: Node) -> Iterator[Check]:
    name = f"{node.role} {node.number}"
    if node.state == "clock_fallback":
        yield wrong(Fault.CLOCK, "clock", f"{name} runs without its crystal", "replace the board", nodes=(node.number,))
    elif node.locked is False:
        yield wrong(
            Fault.CLOCK,
            "clock",
            f"the clock of {name} is not locked to the sync master's",
            "check its sync wire (or CAN, with sync_source 2 or 3), that the sync master is on, and its crystal",
            nodes=(node.number,),
        )


def codes(roster: Roster, site: Site) -> Iterator[Check]:
    """Yield codes of the site that no board drives, and boards whose code is no beacon's or another board's.

    Who drives a code is known only of boards that answered; without any, nothing is yielded.
    """
    driving = [node for node in in_order(roster) if node.drives_coils and node.parameters.get(WAVEFORM) == ONE_CODE]
    if not driving:
        return
    nodes_of: dict[int, list[int]] = {}
    for node in driving:
        nodes_of.setdefault(int(node.parameters.get(CODE) or 0), []).append(node.number)
    missing = [beacon for beacon in site.beacons if beacon.code not in nodes_of]
    strange = [(code, numbers[0]) for code, numbers in nodes_of.items() if code not in site.codes]
    users = Counter(beacon.code for beacon in site.beacons)  # More than one where codes are shared.
    driven = {beacon.code: tuple(nodes_of.get(beacon.code, ())) for beacon in site.beacons}
    first = {beacon.code: beacon for beacon in reversed(site.beacons)}
    shared = [(first[code], numbers) for code, numbers in driven.items() if len(numbers) > users[code]]
    few = [(code, numbers) for code, numbers in driven.items() if 0 < len(numbers) < users[code]]
    if len(missing) > 1 and 2 * len(missing) >= len(site.beacons) and len(strange) >= 2:
        yield wrong(
            Fault.SITE,
            "site file",
            f"{len(missing)} of the site's {len(site.beacons)} codes are driven by no board, and the boards drive "
            f"{', '.join(str(code) for code, _ in strange)} instead",
            f'check that the site file, "{site.name}", is that of this room',
            nodes=tuple(number for _, number in strange),
            beacons=tuple(beacon.id for beacon in missing),
        )
        return
    only = missing[0] if len(missing) == len(strange) + len(shared) == 1 else None
    for code, number in strange:
        yield _wrong_code(f"node {number} drives the code {code}, which is no beacon's", (number,), only)
    for beacon, numbers in shared:
        yield _wrong_code(f"nodes {listed(numbers)} drive the code {beacon.code} of {beacon.id}", numbers, only, beacon)
    for beacon in missing:
        if only is None:
            yield wrong(
                Fault.OFF,
                f"beacon {beacon.id}",
                f"no board with the code {beacon.code} of {beacon.id} is heard",
                "check the board's power and its cable to the bus",
                beacons=(beacon.id,),
            )
    for code, numbers in few:
        names = tuple(beacon.id for beacon in site.beacons if beacon.code == code)
        yield wrong(
            Fault.OFF,
            f"beacons {listed(names)}",
            f"the code {code} of {listed(names)} is driven by {counted(len(numbers), 'boards')} only",
            "check the power and the cable of the others",
            beacons=names,
        )
    if not missing and not strange and not shared and not few:
        how = "one board" if len(users) == len(site.beacons) else "as many boards as have it"
        yield sound("codes", f"each of {counted(len(users), 'codes of the site')} is driven by {how}")


def _wrong_code(text: str, nodes: tuple[int, ...], missing: Beacon | None, shared: Beacon | None = None) -> Check:
    """Return the check of a board with the code of another beacon, or of several of which all but one have.

    ``missing`` is the beacon whose board it must be, if that is known, and ``shared`` the one whose code several have.
    """
    if missing is not None:
        text += f", and no board drives the code {missing.code} of {missing.id}"
    wanted = "CODE" if missing is None else str(missing.code)
    board = f"give the board its beacon's code: {_set(nodes[0], 'code', wanted)}"
    if shared is not None:  # who of them is right is not told by what they say
        board = (
            f"see by goldfield nodes identify {nodes[0]} which of them is not at {shared.id}, and give that board its "
            f"own beacon's code: {_set('NODE', 'code', wanted)}"
        )
    beacons = tuple(beacon.id for beacon in (shared, missing) if beacon is not None)
    return wrong(Fault.CODE, "codes", text, board, nodes=nodes, beacons=beacons)


def _set(node: int | str, parameter: str, value: str) -> str:
    """Return how a parameter of a board is set, and kept."""
    return f"goldfield nodes set {node} {parameter} {value}; goldfield nodes save {node} keeps it"


def drives(roster: Roster, site: Site) -> Iterator[Check]:
    """Yield coils that are off or faulty, and currents that are not the site's."""
    by_code = {beacon.code: beacon for beacon in site.beacons}
    coils = [(node, channel) for node in in_order(roster) for channel in sorted(node.drives)]
    faults: list[Check] = []
    for node, channel in coils:
        code = node.parameters.get(CODE) if node.parameters.get(WAVEFORM) == ONE_CODE else None
        faults += _of_coil(node, channel, by_code.get(int(code)) if code is not None else None)
    yield from faults
    if not coils:
        yield unjudged(
            "currents", "no beacon's board is heard on this link: codes and currents show in the fields alone"
        )
    elif not faults:
        yield sound("currents", counted(len(coils), "coils are driven as the site file says"))


def _of_coil(node: Node, channel: int, beacon: Beacon | None) -> Iterator[Check]:
    drive = node.drives[channel]
    name = f"node {node.number}" + (f" ({beacon.id})" if beacon is not None else "")
    about: dict[str, Any] = {"nodes": (node.number,), "beacons": () if beacon is None else (beacon.id,)}
    complaints = [text for text in drive.complaints if text != UNLOCKED]
    health = node.health.get(channel)
    unarmed, start = node.parameters.get(ARMED) == 0, f"goldfield nodes start {node.number} --save"
    if drive.target_A == 0.0 and unarmed and node.parameters.get(AMPLITUDE):
        yield wrong(Fault.OFF, "coil", f"{name} is not armed: its coil is off", start, **about)
    elif drive.target_A == 0.0:
        yield wrong(
            Fault.OFF,
            "coil",
            f"{name} has an amplitude of 0 A: its coil is off",
            _set(node.number, "amplitude", "AMPERES" if beacon is None else f"{abs(beacon.current_A):g}")
            + (f"; then {start}" if unarmed else ""),
            **about,
        )
    elif health is not None and health.reason is not None:
        text = f"{name} keeps channel {channel} off: {health.reason}"
        yield wrong(Fault.DRIVE, "coil", text, health.remedy(node.number), **about)
    elif complaints and drive.locked:
        yield wrong(
            Fault.DRIVE,
            "coil",
            f"{name} reports {', '.join(complaints)} on channel {channel}",
            f"check coil, cable and supply; then goldfield nodes clear {node.number}",
            **about,
        )
    elif health is not None and health.headroom_lost:
        text = (
            f"{name} does not keep to its current on channel {channel}: {drive.current_A:.2f} of {drive.target_A:g} A"
        )
        yield wrong(
            Fault.DRIVE,
            "coil",
            text,
            "raise its supply, or lower its amplitude; where it is more than asked for, restart the board",
            **about,
        )
    elif beacon is not None and drive.enabled:
        yield from _current(node.number, beacon, drive.current_A)


def _current(number: int, beacon: Beacon, current_A: float) -> Iterator[Check]:
    site_A = abs(beacon.current_A)
    if abs(current_A / site_A - 1.0) > CURRENT_TOLERANCE:
        yield wrong(
            Fault.CURRENT,
            f"beacon {beacon.id}",
            f"node {number} ({beacon.id}) drives {current_A:.2f} A, the site file says {site_A:g} A",
            f"goldfield nodes set {number} amplitude {site_A:g}, or correct current_A of {beacon.id}; if the board's "
            "amplitude is right, check its supply and coil",
            nodes=(number,),
            beacons=(beacon.id,),
        )


def degrees(roster: Roster, site: Site) -> Iterator[Check]:
    """Yield boards that work with codes of another degree than the site's, together those of one degree."""
    told = [(node.number, node.parameters.get(DEGREE)) for node in in_order(roster)]
    for wrong_degree in sorted({int(degree) for _, degree in told if degree not in (None, site.degree)}):
        numbers = tuple(number for number, degree in told if degree == wrong_degree)
        who = f"node {numbers[0]} works" if len(numbers) == 1 else f"nodes {listed(numbers)} work"
        yield wrong(
            Fault.SITE,
            "degree",
            f"{who} with codes of degree {wrong_degree}, the site file says {site.degree}",
            "correct the site file's degree, or store the parameter degree in every board",
            nodes=numbers,
        )


def hosts(roster: Roster) -> Check:
    """Return whether another host spoke to the boards."""
    requests = roster.requests_of_others
    if not requests:
        return sound("hosts", "no other host spoke on this link")
    setting = tuple(sorted({request.node for request in requests if request.name == "PARAM_SET"}))
    if not setting:
        return unjudged(
            "hosts", f"another host asked nodes for parameters, {counted(len(requests), 'times')}, and set none"
        )
    return wrong(
        Fault.HOSTS,
        "hosts",
        f"another host sets parameters of node{'s' * (len(setting) > 1)} {listed(setting)}",
        "end the other program, or let it listen only: two hosts that set one sensor undo each other's work",
        nodes=setting,
    )


def in_order(roster: Roster) -> list[Node]:
    """Return the nodes whose heartbeat was heard, in the order of their numbers."""
    return [node for _, node in sorted(roster.nodes.items()) if node.role not in (None, "host")]

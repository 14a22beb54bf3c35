"""What ``goldfield site`` does on an open link, and how it prints it."""

from __future__ import annotations

import argparse

from goldfield.cli import link_options
from goldfield.cli.output import json_line
from goldfield.errors import SystemFailure, counted, tell
from goldfield.link.budget import SHARE, most_reported
from goldfield.link.line import Line, Link
from goldfield.nodes.commissioning import Board, boards_of, refuse_driven, save_all, switch
from goldfield.nodes.conversation import START, Conversation
from goldfield.nodes.site_boards import Wanted, chosen_codes, differences, push, wanted_of
from goldfield.site import Site
from goldfield_protocol.parameters import label_of


def act(conversation: Conversation, arguments: argparse.Namespace, site: Site) -> None:
    """Set the boards to a site, or compare them with it; a serial port has one board, and the others have their own."""
    conversation.listen()
    boards = boards_of(conversation)
    wanted, missing = wanted_of(site, boards, _fitting(conversation.line, arguments.strongest, site, boards))
    if link_options.chosen(arguments)[0] == "port" and wanted and missing:
        tell(f"{counted(len(missing), 'beacons have')} no board on this port: go on with the ports of the others")
        missing = []
    if arguments.action == "check":
        _check(conversation, arguments, wanted, missing)
        return
    if missing:
        more = "" if len(missing) == 1 else f"; {counted(len(missing) - 1, 'more beacons have')} no board"
        raise SystemFailure(f"{conversation.name}: {missing[0]}{more}: nothing was set")
    if not any(one.owner == "sensor" for one in wanted):
        tell("no sensor is set: none is there, or the beacons of this site have no codes of their own")
    _push(conversation, arguments, wanted, boards)


def _fitting(line: Line, strongest: int | None, site: Site, boards: list[Board]) -> int | None:
    """Return how many codes sensors are to choose: fewer than are wanted, and it is said, if no more fit the link."""
    wanted = chosen_codes(site, strongest)
    if wanted is None:
        return None
    sensors = sum(board.role in ("sensor", "anchor") for board in boards) or 1
    if line.link is Link.SERIAL:
        sensors = 1
    most = most_reported(line, wanted, site.chips, site.chip_period_s, sensors)
    if not most:
        raise SystemFailure(
            f"{counted(sensors, 'sensors')} do not fit into {SHARE[line.link]:.0%} of {line}, each with one code: set "
            "a higher rate with goldfield nodes bit-rate, or power fewer; nothing was set".replace("%", " %")
        )
    if most < wanted:
        tell(
            f"sensors report {most} of the strongest codes, not {wanted}: with {counted(sensors, 'sensors')} more does "
            f"not fit into {SHARE[line.link]:.0%} of {line}".replace("%", " %")
        )
    return most


def _push(conversation: Conversation, arguments: argparse.Namespace, wanted: list[Wanted], boards: list[Board]) -> None:
    refuse_driven(conversation, [one.board for one in wanted], pause=arguments.pause)
    changed = push(conversation, wanted, pause=arguments.pause)
    beacons = [one.board for one in wanted if one.owner != "sensor"]
    if arguments.start:
        switch(conversation, START, beacons)
        save_all(conversation, {board.number: board.unique_id for board in beacons}, pause=True)
    nodes = sorted({one.board.number for one in wanted})
    if arguments.json:
        print(json_line({"nodes": nodes, "changed": changed, "saved": True, "started": bool(arguments.start)}))
        return
    print(f"{counted(len(nodes), 'boards')} set to the site: {counted(changed, 'values')} changed, saved and checked")
    if arguments.start:
        print(f"{counted(len(beacons), 'beacons')} started")
        return
    waiting = [board.number for board in boards if board in beacons and not board.armed]
    if waiting:
        print(f"{counted(len(waiting), 'beacons have')} yet to be started: goldfield nodes start --all --save")


def _check(conversation: Conversation, arguments: argparse.Namespace, wanted: list[Wanted], missing: list[str]) -> None:
    found = differences(conversation, wanted)
    for text in missing:
        print(json_line({"missing": text}) if arguments.json else text)
    for one in found:
        record = {"beacon": one.owner, "node": one.node, "parameter": label_of(one.parameter)}
        print(json_line({**record, "board": one.found, "site": one.wanted}) if arguments.json else str(one))
    if found or missing:
        what = [counted(len(found), "values")] * bool(found)
        what += [counted(len(missing), "beacons without a board")] * bool(missing)
        raise SystemFailure(f"the boards are not as the site says: {' and '.join(what)}; goldfield site push sets them")
    if not arguments.json:
        print(f"{counted(len(wanted), 'boards are')} as the site says")

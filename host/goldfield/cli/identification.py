"""``goldfield nodes identify``: which board is it? It blinks, and a beacon shows its signature to the sensors."""

from __future__ import annotations

import argparse

from goldfield.cli.node_boards import meant
from goldfield.cli.output import json_line, number
from goldfield.errors import SystemFailure
from goldfield.nodes.commissioning import boards_of
from goldfield.nodes.conversation import BLINK, DONE, SIGNATURE, Conversation
from goldfield.nodes.signature import Seen, Watch
from goldfield_protocol.messages import Message

LEAST_WATCHED_S = 2.0
"""A signature is watched so long at least: 20 cycles."""


def identify(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Let a board blink and, if its coil is driven, show its signature; tell which code a sensor sees come and go."""
    node, seconds = arguments.node, min(arguments.blink_s, 0xFFFF)
    signs = False
    if arguments.unique_id is not None or arguments.watch:
        board = meant(boards_of(conversation), node, arguments.unique_id)
        signs = conversation.try_command(node, SIGNATURE, seconds, board.unique_id) == DONE
    else:
        conversation.discover()
        known = conversation.roster.nodes.get(node)
        if known is not None and len(known.unique_ids) == 1:
            signs = conversation.try_command(node, SIGNATURE, seconds, known.unique_ids[0]) == DONE
    if not signs:
        conversation.command(node, BLINK, seconds, arguments.unique_id)
    if not arguments.watch:
        _tell(arguments, seconds, signs)
        return
    if not signs:
        raise SystemFailure(
            f"node {node} blinks, but its coil is not driven: no sensor can see it (goldfield nodes start {node})"
        )
    watch = Watch()

    def take(message: Message) -> bool:
        watch.take(message)
        return False

    conversation.wait(take, max(LEAST_WATCHED_S, seconds - 0.5))
    _tell_seen(arguments, watch.seen(), watch.sensors)


def _tell(arguments: argparse.Namespace, seconds: int, signs: bool) -> None:
    if arguments.json:
        print(json_line({"node": arguments.node, "blinks_s": seconds, "signature": signs}))
        return
    print(f"the LED of node {arguments.node} blinks for {seconds} s")
    if signs:
        print(
            "every other cycle has half its current meanwhile: sensors see it, and poses without it are the better ones"
        )


def _tell_seen(arguments: argparse.Namespace, seen: list[Seen], sensors: list[int]) -> None:
    if not seen:
        heard = "no sensor reports fields" if not sensors else f"no code comes and goes for sensor {sensors[0]}"
        raise SystemFailure(f"node {arguments.node} shows its signature, but {heard}: are its code and theirs set?")
    for one in seen:
        if arguments.json:
            record = {"node": arguments.node, "sensor": one.sensor, "code": one.code}
            print(json_line({**record, "change_T": number(one.change_T)}))
        else:
            print(f"sensor {one.sensor} sees node {arguments.node}: code {one.code} comes and goes")

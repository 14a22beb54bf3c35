"""Which board drives a coil: keys of a ``[[beacon]]`` that the boards are set by, not poses computed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from goldfield.files.toml_table import Table

BOARD_KEYS = ("node", "board", "group")
LARGEST_NODE, LARGEST_GROUP = 4095, 255
UNIQUE_ID = re.compile(r"[0-9a-f]{24}")


@dataclass(frozen=True)
class BeaconBoard:
    """The board of a beacon, as the site file names it.

    Attributes
    ----------
    node : int or None
        Its number.
    unique_id : str or None
        Unique id of its processor, 24 hexadecimal digits.
    group : int or None
        The group that it is to belong to; None: whichever it has.
    """

    node: int | None = None
    unique_id: str | None = None
    group: int | None = None


UNNAMED = BeaconBoard()
"""A beacon whose board is not named: it is the board that has the beacon's id for its name."""


def read_beacon_board(table: Table) -> BeaconBoard:
    """Read ``node`` or ``board``, and ``group``, all optional; `UserError` if one is out of range."""
    if "node" in table and "board" in table:
        raise table.error("node", "and board are both given: give one of them")
    node = table.integer("node") if "node" in table else None
    if node is not None and not 1 <= node <= LARGEST_NODE:
        raise table.error("node", f"is {node}; numbers of nodes are 1 to {LARGEST_NODE}")
    unique_id = table.text("board").lower() if "board" in table else None
    if unique_id is not None and UNIQUE_ID.fullmatch(unique_id) is None:
        raise table.error("board", "is a unique id, 24 hexadecimal digits, as goldfield nodes boards tells it")
    group = table.integer("group") if "group" in table else None
    if group is not None and not 0 <= group <= LARGEST_GROUP:
        raise table.error("group", f"is {group}; groups are 1 to {LARGEST_GROUP}, and 0 is none")
    return BeaconBoard(node, unique_id, group)


def check_boards(tables: Sequence[Table], boards: Sequence[tuple[str, BeaconBoard]]) -> None:
    """Check that no board is named by two beacons, which are given with their ids.

    The two coils of a board that drives a rotating field (``NAME.cos`` and ``NAME.sin``) share it.
    """
    owners: dict[int | str, str] = {}
    for table, (beacon, board) in zip(tables, boards, strict=True):
        for key, name in (("node", board.node), ("board", board.unique_id)):
            if name is None:
                continue
            other = owners.setdefault(name, beacon)
            if other != beacon and other.rpartition(".")[0] != (beacon.rpartition(".")[0] or None):
                raise table.error(key, f'is {name}, which beacon "{other}" already has: each board drives one beacon')

"""A site and the boards that make it: which board is whose, what each must be set to, what differs, and its remedy."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from goldfield.errors import SystemFailure, UserError, counted, listed, tell
from goldfield.link.requests import Value
from goldfield.nodes.commissioning import Board, await_restarts, save_all
from goldfield.nodes.conversation import RESET, Conversation
from goldfield.sensor.dialogue import STRONGEST, wanted_parameters
from goldfield.sensor.on_sensor import on_sensor_parameters
from goldfield.sensor.options import USUAL_STRONGEST, Method, Options, most_strongest
from goldfield.site import Beacon, Site
from goldfield.site.drive import NO_CODE
from goldfield_protocol.parameters import PARAMETERS, Kind, find_id, label_of

ONE_CODE, PULSE, SQUARE, ROTATING, SUPERPOSED = range(5)
"""Values of the parameter ``waveform``."""
NOT_ALONE = "shares its number {number} with another one: goldfield nodes assign gives each its own"
"""What is said of a board that cannot be set alone."""
OF_ITS_OWN = ("pose", "pose_blocks")
"""What a sensor that computes poses has, and the site does not say."""
Values = Mapping[int, Value]
"""Values by the parameter's id."""


@dataclass(frozen=True)
class Wanted:
    """What a site wants of a board.

    Attributes
    ----------
    owner : str
        The beacon's id, or ``"sensor"``.
    board : Board
    values : mapping of int to int or float
        By the parameter's id, as the board keeps them.
    """

    owner: str
    board: Board
    values: Values


@dataclass(frozen=True)
class Difference:
    """A parameter of a board that is not as the site wants it; ``found`` is None if the board did not tell it."""

    owner: str
    node: int
    parameter: int
    found: Value | None
    wanted: Value

    def __str__(self) -> str:
        found = "unknown" if self.found is None else f"{self.found:.7g}"
        return f"{self.owner}, node {self.node}: {label_of(self.parameter)} is {found}, the site says {self.wanted:.7g}"


def beacon_values(site: Site, beacon: Beacon) -> dict[int, Value]:
    """Return the parameters, by id, with which a board is a beacon of a site.

    Raises
    ------
    UserError
        If boards drive no such wave.
    """
    drive = beacon.drive
    values: dict[str, list[Value]] = {"degree": [site.degree], "amplitude": [abs(beacon.current_A)]}
    if site.access == "tdma":
        values |= {"waveform": [PULSE], "slots": [site.slots], "slot": [drive.slot or 0]}
    elif drive.periods is not None:
        paired = beacon.id.rpartition(".")[2] == "cos"
        if not (drive.square or paired):
            raise UserError(
                f'beacon "{beacon.id}": boards drive square tones, or a sine and a cosine on two coils (NAME.cos and '
                "NAME.sin): write one of these"
            )
        values |= {"waveform": [SQUARE if drive.square else ROTATING], "periods": [drive.periods]}
    elif beacon.code != NO_CODE:
        values |= {"waveform": [ONE_CODE], "code": [beacon.code]}
    elif drive.codes:
        rows: list[Value] = [n for code in drive.codes for n in (code.degree, code.index, code.offset, code.hold)]
        count = PARAMETERS["codes"].count
        if len(rows) > count:
            raise UserError(f'beacon "{beacon.id}" has {len(drive.codes)} codes; a board drives 4 at most')
        values |= {"waveform": [SUPERPOSED], "codes": rows + [0] * (count - len(rows))}
    else:
        raise UserError(f'beacon "{beacon.id}": boards drive no tones of any frequency: they are for recordings')
    if beacon.board.group is not None:
        values["group"] = [beacon.board.group]
    return {
        PARAMETERS[name].identifier(element): _kept(PARAMETERS[name].kind, value)
        for name, elements in values.items()
        for element, value in enumerate(elements)
    }


def chosen_codes(site: Site, strongest: int | None = None) -> int | None:
    """Return how many codes the sensors of a site choose by their strength; None: they report those of the site.

    They choose where it is said, and `USUAL_STRONGEST` codes, or as many as they can, where the site has more beacons
    than a list holds, or shares codes.
    """
    shared = site.shared_codes and len({beacon.code for beacon in site.beacons}) < len(site.beacons)
    if strongest is None and (shared or len(site.beacons) > PARAMETERS["code_list"].count):
        return min(USUAL_STRONGEST, most_strongest(site))
    return strongest


def sensor_values(site: Site, strongest: int | None = None) -> dict[int, Value] | None:
    """Return the parameters, by id, of a sensor on a site; None if its sensors report none of its beacons.

    The table of the beacons is among them where a sensor could compute poses of it. Sensors of a site that has more
    beacons than a list holds, or shares codes, have no list and choose what they report (`chosen_codes`).

    Parameters
    ----------
    site : Site
    strongest : int, optional
        How many of the strongest codes the sensor is to report.

    Raises
    ------
    UserError
        If a sensor cannot choose so many.
    """
    if site.access != "cdma" or any(beacon.code == NO_CODE for beacon in site.beacons):
        return None
    chosen = chosen_codes(site, strongest)
    if chosen is not None:
        Options(strongest=chosen).check(site)
    if len(site.beacons) > PARAMETERS["code_list"].count or len(set(site.codes)) < len(site.beacons):
        return {**wanted_parameters(None, {STRONGEST: chosen or 0}), PARAMETERS["degree"].first: site.degree}
    table: dict[int, Value] = {}
    try:
        Options(method=Method.ON_SENSOR).check(site)
    except UserError:
        pass  # Its sensors report fields alone.
    else:
        own = {PARAMETERS[name].first for name in OF_ITS_OWN}
        table = {one: value for one, value in on_sensor_parameters(site).items() if one not in own}
    values = wanted_parameters(site.codes, {**table, STRONGEST: chosen or 0})
    values[PARAMETERS["degree"].first] = site.degree
    kinds = {one: found[0].kind for one in values if (found := find_id(one)) is not None}
    return {one: _kept(kinds[one], value) for one, value in values.items()}


def _kept(kind: Kind, value: Value) -> Value:
    """Return a value as a board keeps it."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0]) if kind is Kind.FLOAT else int(value)


def wanted_of(site: Site, boards: Sequence[Board], strongest: int | None = None) -> tuple[list[Wanted], list[str]]:
    """Return what a site wants of the boards that are there, and a sentence for each beacon without a board.

    A beacon's board is that of its key ``board`` or ``node``, else the one whose name is the beacon's id. All boards
    that sense are sensors of the site, and report what `sensor_values` says.

    Raises
    ------
    UserError
        If boards cannot drive what the site says.
    """
    wanted, missing, owners = [], list[str](), dict[str, str]()
    for beacon in site.beacons:
        if beacon.id.endswith(".sin") and beacon.drive.periods is not None and not beacon.drive.square:
            continue  # Its board is that of the cosine.
        values = beacon_values(site, beacon)
        name = beacon.id.removesuffix(".cos")
        board, said = _board_of(beacon, name, boards)
        owner = name if board is None else owners.setdefault(board.unique_id, name)
        if board is None:
            missing.append(f'beacon "{beacon.id}": {said}')
        elif owner != name:
            missing.append(f'beacon "{beacon.id}": its board, node {board.number}, is that of beacon "{owner}" already')
        else:
            wanted.append(Wanted(name, board, values))
    of_sensor = sensor_values(site, strongest)
    if of_sensor is not None:
        for board in boards:
            if board.role in ("sensor", "anchor") and board.unique_id not in owners and _is_shared(board, boards):
                missing.append(f"sensor: board {board.unique_id} {NOT_ALONE.format(number=board.number)}")
            elif board.role in ("sensor", "anchor"):
                wanted.append(Wanted("sensor", board, of_sensor))
    return wanted, missing


def _board_of(beacon: Beacon, name: str, boards: Sequence[Board]) -> tuple[Board | None, str]:
    """Return the board of a beacon, or None and why there is none."""
    named, lacks, remedy = beacon.board, "", "goldfield nodes assign gives each its own number"
    if named.unique_id is not None:
        found, what = [one for one in boards if one.unique_id == named.unique_id], f"the unique id {named.unique_id}"
    elif named.node is not None:
        found, what = [one for one in boards if one.number == named.node], f"the number {named.node}"
    else:
        found, what = [one for one in boards if one.name == name], f'the name "{name}"'
        lacks, remedy = ", nor has it node or board", "goldfield nodes name gives one of them another"
    if len(found) > 1:
        return None, f"{counted(len(found), 'boards have')} {what}: {remedy}"
    if not found:
        return None, f"no board has {what}{lacks}"
    if _is_shared(found[0], boards):
        return None, f"the board with {what} {NOT_ALONE.format(number=found[0].number)}"
    if found[0].role not in ("beacon", "anchor"):
        return None, f"the board with {what} is a {found[0].role}"
    return found[0], ""


def _is_shared(board: Board, boards: Sequence[Board]) -> bool:
    """Whether another board has its number: what is set by the number would be set in both."""
    return sum(other.number == board.number for other in boards) > 1


def differences(conversation: Conversation, wanted: Sequence[Wanted]) -> list[Difference]:
    """Return what the boards do not have as a site wants it."""
    told = conversation.read((one.board.number, parameter) for one in wanted for parameter in one.values)
    return [
        Difference(one.owner, one.board.number, parameter, found, value)
        for one in wanted
        for parameter, value in one.values.items()
        if (found := told.get((one.board.number, parameter))) != value
    ]


@contextmanager
def _told_if_cut_off(late: Collection[int]) -> Iterator[None]:
    """Say what a push that ends amid its work, by Ctrl-C or a lost link, leaves behind.

    Boards tell what they are set to, not what of it they have saved, and not which value they have started with: what
    is missing then is seen by no comparison.
    """
    try:
        yield
    except BaseException:
        tell(
            "not all boards may have saved what was set, and it would end with a reset: push the site again",
            failure=True,
        )
        if late:
            numbers = listed(sorted(late))
            tell(f"then restart those whose degree changes, {numbers}, each with goldfield nodes reset", failure=True)
        raise


def push(conversation: Conversation, wanted: Sequence[Wanted], *, pause: bool) -> int:
    """Set boards to what a site wants of them, save it, and restart those that read something at their start only.

    Returns
    -------
    int
        How many values were changed.

    Raises
    ------
    SystemFailure
        If a board does not answer, refuses, or has another value in the end.
    """
    changes = differences(conversation, wanted)
    boards = {one.board.number: one.board.unique_id for one in wanted}
    late = {one.node for one in changes if (found := find_id(one.parameter)) is not None and found[0].at_start}
    with _told_if_cut_off(late):
        conversation.write({(change.node, change.parameter): change.wanted for change in changes})
        save_all(conversation, boards, pause=pause)
        nodes = conversation.roster.nodes
        if late:
            before = {number: nodes[number].restarts if number in nodes else 0 for number in late}
            conversation.commands({number: (0, boards[number]) for number in late}, RESET)
            await_restarts(conversation, before, "was restarted")
    left = differences(conversation, wanted)
    if left:
        raise SystemFailure(f"{conversation.name}: {left[0]} even after it was set: try again")
    return len(changes)

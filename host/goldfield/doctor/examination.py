"""The examination: machine, link, boards, beacons, one after the other, each built on the soundness of those before."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing
from itertools import islice

from goldfield.doctor import boards, machine, poses
from goldfield.doctor.checks import Check, Fault, sound, unjudged, wrong
from goldfield.errors import SystemFailure, UserError, counted
from goldfield.link.access_key import AccessKey
from goldfield.link.ports import kernel_can_errors
from goldfield.link.traffic import DAMAGED, ERROR, damaged
from goldfield.nodes.conversation import Conversation
from goldfield.nodes.roster import Node, Roster
from goldfield.nodes.tap import Tap
from goldfield.sensor.health import MANY_EDGES, SYNC_REJECTED
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Epoch, Sensor
from goldfield.site import Site
from goldfield_protocol.parameters import PARAMETERS, counter_name

LISTEN_S = 3.2
"""How long the link is listened to: three heartbeats of each node, s."""
EPOCHS = 20
"""Cycles whose fields are looked at."""
SETTLING = 3
"""Cycles before them: what came while the sensor was made ready."""
BAD_SHARE = 0.01
"""Share of corrupt frames above which a link is called bad."""


class Examination:
    """Examines an installation; `checks` yields what it finds as it goes.

    Parameters
    ----------
    kind, where : str
        The link: ``"port"`` and its path, or ``"can"`` and ``INTERFACE:CHANNEL``.
    site : Site
    node : int, optional
        Node of the sensor; None: the first one in the order of numbers.
    key : AccessKey, optional
        What unlocks a sensor that is locked and does not report the site's codes yet.
    bit_rate : int, optional
        Bits a second of the link, as for `goldfield.nodes.opening.open_link`.
    """

    def __init__(
        self,
        kind: str,
        where: str,
        site: Site,
        node: int | None = None,
        key: AccessKey | None = None,
        bit_rate: int | None = None,
    ) -> None:
        self._kind, self._where, self._key = kind, where, key
        self._site = site
        self._node = node
        self._bit_rate = bit_rate
        self._found: list[Check] = []

    def checks(self) -> Iterator[Check]:
        """Yield each check; the examination ends early where nothing further could be judged."""
        for check in self._all():
            self._found.append(check)
            yield check

    def _all(self) -> Iterator[Check]:
        yield from machine.installation()
        problem = machine.permission(self._kind, self._where)
        if problem is not None:
            yield problem
            return
        link = machine.opened(self._kind, self._where, self._bit_rate)
        if isinstance(link, Check):
            yield link
            return
        errors = self._bus_errors()
        with closing(Tap(link, self._key)) as tap:
            silent, line = (yield from self._of_link(tap)), tap.line
        if silent:
            bad = damaged(tap.others) + tap.others[ERROR] + self._bus_errors() - errors
            yield machine.silence(self._kind, self._where, line, bad)

    def _of_link(self, tap: Tap) -> Generator[Check, None, bool]:
        """Yield what is found on an open link; return whether no node was heard."""
        conversation, roster = Conversation(tap), tap.roster
        errors = self._bus_errors()
        conversation.listen(LISTEN_S)
        if not boards.in_order(roster):
            return True
        conversation.discover()
        numbers = ", ".join(str(node.number) for node in boards.in_order(roster))
        yield sound("link", f"node {numbers} at {self._where}, {tap.line}")
        yield from boards.firmware(roster)
        conversation.read(
            [(n.number, p) for n in boards.in_order(roster) if n.same_protocol for p in boards.ASKED], tries=2
        )
        yield from boards.timing(roster, whole_bus=self._kind == "can")
        yield from boards.degrees(roster, self._site)
        yield from boards.codes(roster, self._site)
        yield from boards.drives(roster, self._site)
        before = {number: dict(node.counters) for number, node in roster.nodes.items()}
        yield from self._of_sensor(tap, roster)
        yield from self._of_counters(roster, before)
        yield from self._corrupt_frames(tap, roster)
        if self._bus_errors() > errors:
            yield wrong(
                Fault.LINK,
                "CAN",
                f"the interface counted {counted(self._bus_errors() - errors, 'bus errors')}",
                "check termination",
            )
        yield boards.hosts(roster)
        return False

    # ---- The sensor and its fields ----

    def _of_sensor(self, tap: Tap, roster: Roster) -> Iterator[Check]:
        sensor = self._sensor(roster)
        if isinstance(sensor, Check):
            yield sensor
            return
        blocking = [check for check in self._found if _forbids_poses(check, sensor)]
        if blocking:
            yield unjudged("beacons", f"the fields mean nothing before this is mended: {blocking[0].text}")
            return
        try:
            epochs = self._epochs(tap, sensor.number)
        except (UserError, SystemFailure) as error:
            text, _, advice = str(error).rpartition(": ")
            yield wrong(Fault.NO_SENSOR, "sensor", text or str(error), advice, nodes=(sensor.number,))
            return
        yield from poses.judged(poses.seen(self._site, epochs), self._site, self._found)
        yield from self._of_code_list(tap, sensor.number)

    def _sensor(self, roster: Roster) -> Node | Check:
        nodes = {node.number: node for node in boards.in_order(roster)}
        sensors = [number for number, node in nodes.items() if node.role == "sensor"]
        number = self._node if self._node is not None else sensors[0] if sensors else None
        if number in nodes and nodes[number].role in ("sensor", "anchor"):
            return nodes[number]
        heard = ", ".join(f"{node.role} {number}" for number, node in nodes.items())
        return wrong(
            Fault.NO_SENSOR,
            "sensor",
            f"{'no sensor' if self._node is None else f'sensor {self._node}'} is heard, only {heard}",
            "power the sensor and check its cable, or choose an anchor with --node N",
        )

    def _epochs(self, tap: Tap, number: int) -> list[Epoch]:
        """Return some epochs of the sensor, which is set to the site's codes, as `goldfield run` does it."""
        sensor = Sensor(tap, self._where, self._site, Options(node=number))
        return list(islice(sensor.epochs(), SETTLING, SETTLING + EPOCHS))

    def _of_code_list(self, tap: Tap, number: int) -> Iterator[Check]:
        """Yield whether the sensor still reports the codes that it was set to."""
        codes = self._site.codes
        first = [PARAMETERS["strongest"].first, PARAMETERS["code_count"].first]
        ids = [*first, *(PARAMETERS["code_list"].identifier(i) for i in range(len(codes)))]
        found = Conversation(tap).read([(number, parameter) for parameter in ids])
        values = [found.get((number, parameter)) for parameter in ids]
        if None not in values and values != [0, len(codes), *codes]:
            yield wrong(
                Fault.HOSTS,
                "hosts",
                f"the code list of sensor {number} was changed while its fields were looked at",
                "end the other program that sets this sensor",
                nodes=(number,),
            )

    # ---- What went wrong on the way ----

    def _of_counters(self, roster: Roster, before: dict[int, dict[int, int]]) -> Iterator[Check]:
        """Yield error counters that grew meanwhile; those of before may tell of a start long ago."""
        for node in boards.in_order(roster):
            old = before.get(node.number, {})
            grown = {index: count - old.get(index, 0) for index, count in node.counters.items()}
            said = [counted(count, counter_name(index)) for index, count in sorted(grown.items()) if count > 0]
            if grown.get(SYNC_REJECTED, 0) >= 2 * MANY_EDGES and old:
                edges = counted(grown[SYNC_REJECTED], "edges of the sync wire at wrong times")
                yield wrong(
                    Fault.MASTERS,
                    "sync wire",
                    f"node {node.number} found {edges}",
                    "set sync_master = 1 in one board only, or look for what disturbs the wire",
                    nodes=(node.number,),
                )
            elif said and old:
                yield wrong(
                    Fault.LINK,
                    f"node {node.number}",
                    f"node {node.number} counted {', '.join(said)} in these seconds",
                    "docs/parameters.md tells what each counter means",
                    nodes=(node.number,),
                )

    def _corrupt_frames(self, tap: Tap, roster: Roster) -> Iterator[Check]:
        bad, good = damaged(tap.others), sum(node.messages for node in roster.nodes.values())
        if bad > BAD_SHARE * (bad + good):
            yield wrong(
                Fault.LINK,
                "link",
                f"of {counted(bad + good, 'frames')} {bad} {'was' if bad == 1 else 'were'} corrupt",
                "check cable, ground and adapter; that nothing else writes to this port",
            )
        foreign = {kind: count for kind, count in tap.others.items() if count and kind not in DAMAGED}
        if foreign:
            said = ", ".join(counted(count, kind) for kind, count in foreign.items())
            yield unjudged("foreign traffic", f"{said}: left out")

    def _bus_errors(self) -> int:
        interface, _, channel = self._where.partition(":")
        return kernel_can_errors(channel) if (self._kind, interface) == ("can", "socketcan") else 0


def _forbids_poses(check: Check, sensor: Node) -> bool:
    """Tell whether a fault makes every pose of a sensor meaningless."""
    of_sensor = not check.nodes or sensor.number in check.nodes
    if check.fault in (Fault.CLOCK, Fault.FIRMWARE, Fault.NUMBERS):
        return of_sensor
    return check.fault in (Fault.MASTERS, Fault.SITE)

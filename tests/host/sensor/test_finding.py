"""Which sensor is read: on a live link, and in a recording."""

import itertools
from types import SimpleNamespace

import can
import pytest

from goldfield import site as sites
from goldfield.errors import SystemFailure, UserError
from goldfield.link.buses import open_can
from goldfield.link.marks import is_mark, mark, reads
from goldfield.link.traffic import OTHER_CHANNEL, OTHER_PROTOCOL
from goldfield.sensor import finding
from goldfield.sensor.receiver import Receiver
from goldfield.sensor.session import Session
from goldfield_protocol import encode
from tests.host.fake_sensor import NODE, SITE, cycle_messages, heartbeat
from tests.host.virtual_link import next_or_none

ROOM = sites.load(SITE)


def test_nothing_heard_and_the_wrong_node_heard(virtual):
    link, session = virtual(node=7)
    for second in range(60):
        link.deliver(heartbeat(), after_s=second + 0.3)
    with pytest.raises(SystemFailure, match=r"no heartbeat of sensor 7 in 30 s; heard only sensor 100"):
        session.find()
    _, session = virtual()
    with pytest.raises(SystemFailure, match=r"no heartbeat of a sensor in 10 s; heard nothing: check the power"):
        session.find()


def test_a_heartbeat_is_awaited_to_the_end_of_patience_while_something_is_heard(virtual):
    """Boards that are simulated slower than the wall clock: cycles come, the heartbeat takes long."""
    for delay_s, found in ((29.0, True), (31.0, False)):
        link, session = virtual()
        for number in range(8):
            link.deliver(cycle_messages(number)[0], after_s=4.0 * number)
        link.deliver(heartbeat(), after_s=delay_s)
        if found:
            session.find()
            assert session.node == NODE
        else:
            with pytest.raises(SystemFailure, match="no heartbeat of a sensor in 30 s; heard only EPOCH of node 100"):
                session.find()


def test_anchors_are_read_when_asked_for(virtual):
    sender, source = open_can("virtual:anchors"), open_can("virtual:anchors")

    def send_all():
        for message in [heartbeat(node=3, role=3), heartbeat(), *cycle_messages(4), heartbeat(node=3, role=3)]:
            sender.send(*message)

    send_all()
    session = Session(source, "virtual:anchors", ROOM)
    session.find()
    assert session.node == 100
    send_all()
    session = Session(source, "virtual:anchors", ROOM, node=3)
    session.find()
    assert session.node == 3
    sender.close()
    source.close()
    link, session = virtual()
    link.deliver(heartbeat(node=3, role=3))
    with pytest.raises(SystemFailure, match=r"heard only anchor 3 \(to read it, give node=3\)"):
        session.find()


def test_a_log_that_begins_with_an_anchors_reports():
    class Log:
        traffic = {}  # noqa: RUF012

        def __init__(self):
            messages = [*cycle_messages(4), *cycle_messages(5), heartbeat(role=3), *cycle_messages(6)]
            self.left = [can.Message(arbitration_id=identifier, data=data) for identifier, data in messages]

        def receive(self, timeout_s):
            return self.left.pop(0) if self.left else None

    with pytest.raises(UserError, match="node 100 is an anchor: give node=100 to read it, or the number"):
        list(Session(Log(), "x.log", ROOM).reports())
    session = Session(Log(), "x.log", ROOM, node=100)
    assert [report.cycle for report in session.reports()] == [4, 5, 6]


def test_a_beacon_with_another_protocol_is_told_and_ignored(virtual, capsys):
    link, session = virtual()
    foreign = [heartbeat(node=3, role=0, hash_=1), encode("COUNTER", {"counter": 2, "value": 9}, node=3, index=2)]
    for message in [heartbeat(), *foreign, *cycle_messages(4), *foreign, *cycle_messages(5), *foreign]:
        link.deliver(message)
    session.find()
    reports = session.reports()
    assert [next(reports).cycle, next(reports).cycle] == [4, 5]
    err = capsys.readouterr().err
    assert err.count("node 3 (beacon, firmware 0.1.0) speaks protocol 0x00000001") == 1
    assert "flash it with the beacon firmware of this host's version (make flash ROLE=beacon)" in err
    assert session.receiver.traffic[OTHER_PROTOCOL] == 4
    assert 3 not in session.health.boards
    link.deliver(heartbeat(node=3, role=0))
    link.deliver(heartbeat(hash_=5))
    with pytest.raises(UserError, match=r"node 100 \(sensor, firmware 0.1.0\) speaks protocol 0x00000005"):
        next(reports)
    assert 3 in session.health.boards, "it has been flashed meanwhile"


def test_of_two_sensors_one_is_chosen(virtual):
    others = [heartbeat(node=7), heartbeat(node=3, role=0)]
    link, session = virtual()
    link.shared = True
    for message in [heartbeat(), *others]:
        link.deliver(message, after_s=0.9)
    with pytest.raises(UserError, match=r"several sensors: sensor 7 \(node=7\), sensor 100 \(node=100\): choose one"):
        session.find()
    for node in (7, 100):
        link, session = virtual(node=node)
        link.shared = True
        for message in [heartbeat(), *others]:
            link.deliver(message)
        session.find()
        assert session.node == node


def test_a_sensor_of_another_protocol_does_not_hide_one_that_can_be_read(virtual, capsys):
    link, session = virtual()
    link.shared = True
    link.deliver(heartbeat(node=7, hash_=1))
    link.deliver(heartbeat(), after_s=1.0)
    session.find()
    assert session.node == NODE
    link, session = virtual(node=7)
    link.deliver(heartbeat(node=7, hash_=1))
    with pytest.raises(UserError, match=r"node 7 \(sensor.*make flash ROLE=sensor"):
        session.find()


def test_a_second_sensor_that_comes_later_is_told(virtual, capsys):
    link, session = virtual()
    for message in [heartbeat(), *cycle_messages(4), heartbeat(node=7), *cycle_messages(5), heartbeat(node=7)]:
        link.deliver(message)
    session.find()
    reports = session.reports()
    assert [next(reports).cycle, next(reports).cycle] == [4, 5]
    assert next_or_none(reports) is None
    assert capsys.readouterr().err == "goldfield: virtual: sensor 7 is there too: 100 is read; node=7 reads it\n"


class LogOf:
    """A recording with these messages: (identifier, data), or with a channel before them."""

    traffic = {}  # noqa: RUF012

    def __init__(self, messages):
        self.left = []
        for place, message in enumerate(messages):
            channel, identifier, data = message if len(message) == 3 else (None, *message)
            self.left.append(can.Message(0.01 * place, identifier, channel=channel, data=data))

    def receive(self, timeout_s):
        return self.left.pop(0) if self.left else None


def recorded(cycles, marks):
    """What is read of a recording with marks before some of its cycles: the node that is read, or None."""
    source = LogOf([])
    for cycle in cycles:
        source.left += [mark(marks[cycle], 0.01 * len(source.left))] if cycle in marks else []
        source.left += [can.Message(0.01 * len(source.left), i, data=data) for i, data in cycle_messages(cycle)]
    session = Session(source, "x.log", ROOM)
    return [report.cycle for report in session.reports()]


@pytest.mark.parametrize(
    ("marks", "wanted"),
    [
        ({}, [0, 1, 2, 3, 4, 5]),
        ({0: None, 2: NODE}, [2, 3, 4, 5]),
        ({0: None, 1: NODE, 3: None, 4: NODE}, [1, 2, 3, 4, 5]),
        ({0: None}, [0, 1, 2, 3, 4, 5]),
        ({0: None, 2: NODE, 4: None}, [2, 3]),
    ],
    ids=["none", "looked for first", "set again: cycle 3 is empty", "killed before it read", "killed while set again"],
)
def test_a_replay_reads_what_the_run_read(marks, wanted):
    assert recorded(range(6), marks) == wanted


def test_what_a_replay_does_not_read_at_the_end_is_told(capsys):
    recorded(range(6), {0: None, 2: NODE, 5: None})
    said = "goldfield: x.log: 11 messages of the sensor were not read at the end, where it was being set\n"
    assert capsys.readouterr().err == said
    recorded(range(6), {0: None, 2: NODE, 4: None, 5: NODE})
    assert capsys.readouterr().err == ""


def test_a_mark_that_does_not_come_is_not_waited_for(monkeypatch):
    """A file of a stranger, which is larger than the memory."""
    monkeypatch.setattr(finding, "LOOKED_THROUGH", 20)
    assert recorded(range(6), {0: None, 4: NODE}) == list(range(6))


def test_a_run_marks_where_it_reads(virtual):
    link, session = virtual(parameters={28: 10})
    kept = []
    session.receiver = Receiver(link, "virtual", SimpleNamespace(write=kept.append), session._listen)
    for message in (heartbeat(), *cycle_messages(0)):
        link.deliver(message)
    for cycle in (1, 2):
        for message in cycle_messages(cycle):
            link.deliver(message, after_s=5.0 + cycle)
    session.start()
    assert [report.cycle for report in itertools.islice(session.reports(), 2)] == [1, 2]
    marks = [place for place, message in enumerate(kept) if is_mark(message)]
    assert [reads(kept[place]) for place in marks] == [False, True]
    assert (marks[0], kept[marks[1] + 1].arbitration_id) == (0, cycle_messages(1)[0][0])


def interleaved(cycles, senders):
    """Cycles of several sensors, each a (channel, node); that of another node has the number in its identifiers."""
    for cycle in cycles:
        for channel, node in senders:
            for identifier, data in cycle_messages(cycle + 50 * (node != NODE) + 200 * (channel == "can1")):
                yield channel, identifier & ~0xFFF | node, data


def test_of_several_channels_and_nodes_in_a_log_one_is_chosen():
    senders = [("can0", NODE), ("can1", NODE), ("can1", 7)]

    def cycles(node=None, channel=None):
        session = Session(LogOf(interleaved(range(3), senders)), "x.log", ROOM, node, channel=channel)
        return [report.cycle for report in session.reports()], session

    with pytest.raises(
        UserError,
        match=r"x.log: there are several sensors: sensor 100 on can0 \(channel=can0\), sensor 7 on can1 "
        r"\(channel=can1 node=7\), sensor 100 on can1 \(channel=can1 node=100\): choose one",
    ):
        cycles()
    got, session = cycles(channel="can0")
    assert got == [0, 1, 2]
    assert session.receiver.traffic[OTHER_CHANNEL] == 66
    assert cycles(node=7)[0] == [250, 251, 252]
    assert cycles(node=NODE, channel="can1")[0] == [200, 201, 202]
    with pytest.raises(UserError, match=r"sensor 100 on can0 \(channel=can0\), sensor 100 on can1 \(channel=can1\)"):
        cycles(node=NODE)
    assert cycles(channel="can7")[0] == []

"""The conversation with a sensor: found, checked, configured, read."""

import dataclasses
import itertools

import can
import pytest

from goldfield import site as sites
from goldfield.errors import SystemFailure, UserError
from goldfield.link.buses import open_can, open_port
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.session import Session
from goldfield_protocol import encode
from tests.host.fake_sensor import CODES, NODE, SITE, PtySensor, cycle_messages, heartbeat
from tests.host.virtual_link import VirtualLink

ROOM = sites.load(SITE)


def connect(sensor, node=None):
    source = open_port(sensor.path)
    return source, Session(source, sensor.path, ROOM, node)


@pytest.fixture
def virtual(monkeypatch):
    """Return a function that makes a link in virtual time and a session on it, which tells the time by the link."""

    def make(node=None, **options):
        link = VirtualLink(**options)
        monkeypatch.setattr(sessions, "time", link)
        monkeypatch.setattr(dialogues, "time", link)
        return link, Session(link, "virtual", ROOM, node)

    return make


def test_a_fresh_sensor_is_set_to_the_sites_codes():
    with PtySensor(range(3)) as sensor:
        source, session = connect(sensor)
        assert session.start()
        assert session.node == NODE
        assert [sensor.parameters[256 + i] for i in range(8)] == list(CODES)
        assert sensor.parameters[5] == 8
        reports = list(itertools.islice(session.reports(), 3))
        assert [(r.cycle, r.complete) for r in reports] == [(0, True), (1, True), (2, True)]
        source.close()


def test_a_sensor_that_is_set_already_is_left_alone():
    parameters = {5: 8, **{256 + i: code for i, code in enumerate(CODES)}}
    with PtySensor([], parameters=parameters) as sensor:
        source, session = connect(sensor)
        assert not session.start()
        assert all(request.startswith("get") for request in sensor.requests)
        source.close()


def test_a_sensor_that_restarts_is_set_again():
    with PtySensor(range(4)) as sensor:
        source, session = connect(sensor)
        session.start()
        reports = session.reports()
        assert [next(reports).cycle for _ in range(4)] == [0, 1, 2, 3]
        sensor.restart(range(2))
        assert [next(reports).cycle for _ in range(2)] == [0, 1]
        assert sensor.parameters[263] == CODES[-1]
        assert session.assembler.restarts == 1
        source.close()


def test_lost_requests_are_repeated(virtual):
    link, session = virtual(node=NODE, deaf=dialogues.TRIES - 1)
    assert session.dialogue.configure(CODES)
    assert link.requests[: dialogues.TRIES] == [("PARAM_GET", 256)] * dialogues.TRIES
    assert [link.parameters[256 + i] for i in range(8)] == list(CODES)
    assert link.parameters[5] == 8


def test_a_deaf_sensor_is_given_up(virtual):
    link, session = virtual(node=NODE, deaf=dialogues.TRIES)
    begin_s = link.now_s
    with pytest.raises(SystemFailure, match=r"did not answer a request for parameter code_list\[0\] in 5 tries"):
        session.dialogue.configure(CODES)
    assert link.requests == [("PARAM_GET", 256)] * dialogues.TRIES
    assert link.now_s - begin_s == pytest.approx(dialogues.TRIES * dialogues.ANSWER_S)


def test_a_refusal_is_told():
    with PtySensor([], refuse=2) as sensor:
        source, session = connect(sensor)
        session.find()
        with pytest.raises(
            SystemFailure, match=r"sensor 100 says that parameter code_list\[0\] is out of range \(0 to 2048\)"
        ):
            session.dialogue.configure(CODES)
        source.close()


def test_more_codes_than_a_sensor_reports():
    with PtySensor([]) as sensor:
        source, session = connect(sensor, node=NODE)
        with pytest.raises(UserError, match="65 beacons, a sensor reports 64"):
            session.dialogue.configure(range(65))
        source.close()


def test_a_sensor_of_another_degree_is_refused():
    with PtySensor([]) as sensor:
        source = open_port(sensor.path)
        session = Session(source, sensor.path, dataclasses.replace(ROOM, degree=11))
        with pytest.raises(UserError, match="sensor 100 works with codes of degree 10, the site file says 11: correct"):
            session.start()
        source.close()


def test_another_protocol_is_refused_with_the_firmware_to_flash():
    with PtySensor([], hash_=0x1234) as sensor:
        source, session = connect(sensor)
        with pytest.raises(UserError, match=r"node 100 \(sensor, firmware 0.1.0\) .* 0x00001234 .* ROLE=sensor"):
            session.find()
        source.close()


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
        bad_frames = 0

        def __init__(self):
            messages = [*cycle_messages(4), *cycle_messages(5), heartbeat(role=3), *cycle_messages(6)]
            self.left = [can.Message(arbitration_id=identifier, data=data) for identifier, data in messages]

        def receive(self, timeout_s):
            return self.left.pop(0) if self.left else None

    with pytest.raises(UserError, match="node 100 is an anchor: give node=100 to read it, or the number"):
        list(Session(Log(), "x.log", ROOM).reports())
    session = Session(Log(), "x.log", ROOM, node=100)
    assert [report.cycle for report in session.reports()] == [4, 5, 6]


def test_can_buses_carry_the_same():
    """On CAN the beacons' messages are there too; another beacon's protocol is refused as well."""
    sender, source = open_can("virtual:both"), open_can("virtual:both")
    session = Session(source, "virtual:both", ROOM)
    for message in [heartbeat(node=3, role=0), heartbeat(), *cycle_messages(4), *cycle_messages(5)]:
        sender.send(*message)
    session.find()
    reports = session.reports()
    assert [next(reports).cycle, next(reports).cycle] == [4, 5]
    sender.send(*heartbeat(node=3, role=0, hash_=1))
    with pytest.raises(UserError, match=r"node 3 \(beacon.*ROLE=beacon"):
        next(reports)
    sender.close()
    source.close()


def test_a_sensor_that_falls_silent_while_others_talk(virtual):
    link, session = virtual()
    for message in cycle_messages(4)[:-1]:
        link.deliver(message)
    for number in range(400):
        link.deliver(heartbeat(node=3, role=0), after_s=0.05 * number)
    begin_s = link.now_s
    reports = session.reports()
    assert next(reports).lost(8) == 1
    assert link.now_s - begin_s == pytest.approx(sessions.QUIET_S, abs=0.051)
    with pytest.raises(SystemFailure, match="sensor 100 has been silent for 10 s"):
        next(reports)
    assert link.now_s - begin_s == pytest.approx(sessions.SILENCE_S, abs=0.051)


def test_a_message_of_the_wrong_length_is_counted():
    sender, source = open_can("virtual:short"), open_can("virtual:short")
    session = Session(source, "virtual:short", ROOM)
    identifier, data = cycle_messages(4)[0]
    sender.send(identifier, data[:3])
    identifier, data = encode("PARAM_VALUE", {"kind": 1, "status": 0, "value_signed": -1}, node=NODE, index=9)
    sender.send(identifier, data)
    sender.send(identifier, b"\x03" + data[1:])  # there is no kind 3
    sender.send(*heartbeat())
    session.find()
    assert session.receiver.bad_frames == 2
    sender.close()
    source.close()

"""The conversation with a sensor that is there: checked, configured, read."""

import dataclasses
import itertools

import pytest

from goldfield import site as sites
from goldfield.errors import SystemFailure, UserError
from goldfield.link.buses import open_can, open_port
from goldfield.link.traffic import MEANINGLESS, WRONG_LENGTH
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import finding
from goldfield.sensor import session as sessions
from goldfield.sensor.session import Session
from goldfield_protocol import encode
from tests.host.fake_sensor import CODES, NODE, SITE, PtySensor, cycle_messages, heartbeat
from tests.host.virtual_link import VirtualLink, next_or_none, told_by

ROOM = sites.load(SITE)


def connect(sensor, node=None):
    source = open_port(sensor.path)
    return source, Session(source, sensor.path, ROOM, node)


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


def test_can_buses_carry_the_same():
    """On CAN the beacons' messages are there too; another beacon's protocol is refused as well."""
    sender, source = open_can("virtual:both"), open_can("virtual:both")
    session = Session(source, "virtual:both", ROOM)
    for message in [heartbeat(node=3, role=0), heartbeat(), *cycle_messages(4), *cycle_messages(5)]:
        sender.send(*message)
    session.find()
    reports = session.reports()
    assert [next(reports).cycle, next(reports).cycle] == [4, 5]
    sender.close()
    source.close()


def test_another_host_that_sets_the_sensor_is_told_and_undone(virtual, capsys):
    link, session = virtual(parameters={28: 10})
    link.deliver(heartbeat())
    assert session.start() is True
    foreign = [encode("PARAM_SET", {"kind": 0, "value_unsigned": 3}, node=NODE, index=5)]
    foreign += [encode("PARAM_VALUE", {"kind": 0, "status": 0, "value_unsigned": 3}, node=NODE, index=5)]
    link.parameters[5] = 3
    link.requests.clear()
    for message in [*cycle_messages(4), *foreign, *cycle_messages(5)]:
        link.deliver(message)
    reports = session.reports()
    assert [next(reports).cycle, next(reports).cycle] == [4, 5]
    assert link.requests == [("PARAM_SET", 5)]
    assert link.parameters[5] == 8
    assert session.keeping.changes == 1
    err = capsys.readouterr().err
    assert "another host sets parameters of sensor 100" in err
    assert "another host has set code_count of sensor 100 to 3: put back to 8" in err


def test_two_hosts_that_want_different_things_do_not_fight_for_ever(virtual, capsys):
    link, session = virtual(parameters={28: 10})
    link.deliver(heartbeat())
    session.start()
    link.requests.clear()
    for cycle in range(20):
        link.parameters[5] = 3
        value = {"kind": 0, "status": 0, "value_unsigned": 3}
        for message in [*cycle_messages(cycle), encode("PARAM_VALUE", value, node=NODE, index=5)]:
            link.deliver(message, after_s=0.1 * cycle)
    reports = session.reports()
    assert [next(reports).cycle for _ in range(20)] == list(range(20))
    assert next_or_none(reports) is None
    assert link.requests == [("PARAM_SET", 5)] * 5
    assert capsys.readouterr().err.count("this one has put it back 5 times") == 1


def test_what_is_left_of_another_host_is_put_back_when_it_has_ended(virtual, capsys):
    """It wins, since it goes on for longer; ten seconds after giving up the sensor is looked at again, once."""
    link, session = virtual(parameters={28: 10})
    link.deliver(heartbeat())
    session.start()
    link.requests.clear()
    for cycle in range(300):
        value = {"kind": 0, "status": 0, "value_unsigned": 7}
        foreign = [encode("PARAM_VALUE", value, node=NODE, index=5)] if 20 <= cycle < 40 else []
        for message in [*cycle_messages(cycle, codes=CODES[: 8 if cycle < 20 else 7]), *foreign]:
            link.deliver(message, after_s=0.1 * cycle)
    reports = session.reports()
    put_back = []
    for cycle in range(300):
        before = len(link.requests)
        if 20 <= cycle < 150:
            link.parameters[5] = 7
        assert next(reports).cycle == cycle
        put_back += [cycle for name, number in link.requests[before:] if (name, number) == ("PARAM_SET", 5)]
    assert put_back[:5] == [20, 21, 22, 23, 24]
    assert 120 <= put_back[5] < 130, "ten seconds after it gave up"
    assert link.parameters[5] == 8


def test_a_value_that_another_host_overwrites_is_set_again(virtual):
    """The answer to its request comes in the place of ours."""
    link, session = virtual(parameters={28: 10})
    link.deliver(heartbeat())
    session.find()
    for _ in range(2):
        link.deliver(encode("PARAM_VALUE", {"kind": 0, "status": 0, "value_unsigned": 7}, node=NODE, index=5))
    session.dialogue.set(5, 8)
    assert link.requests == [("PARAM_SET", 5)] * 3
    link, session = virtual(node=NODE)
    for _ in range(5):
        link.deliver(encode("PARAM_VALUE", {"kind": 0, "status": 0, "value_unsigned": 7}, node=NODE, index=5))
    with pytest.raises(SystemFailure, match=r"keeps parameter code_count at 7 instead of 8, 5 times: end what else"):
        session.dialogue.set(5, 8)


def test_a_change_behind_our_back_shows_in_the_reports(virtual, capsys):
    """Set on the serial port, while this host is on CAN: nobody hears it, but the reports have other codes."""
    link, session = virtual(parameters={28: 10})
    link.deliver(heartbeat())
    session.start()
    link.parameters[256 + 7] = 77
    link.requests.clear()
    codes = [*CODES[:-1], 77]
    for cycle in range(20):
        for identifier, data in cycle_messages(cycle):
            field = identifier >> 24 == 5
            moved = field and identifier >> 12 & 0xFFF == CODES[-1]
            link.deliver((5 << 24 | codes[-1] << 12 | NODE, data) if moved else (identifier, data), 0.1 * cycle)
    reports = session.reports()
    while link.parameters[256 + 7] == 77:
        next(reports)
    assert link.parameters[256 + 7] == CODES[-1]
    assert link.requests.count(("PARAM_SET", 256 + 7)) == 1
    assert "another host has set code_list[7] of sensor 100 to 77: put back to 9" in capsys.readouterr().err


class Stopped(VirtualLink):
    """The process is stopped for 30 s when so many messages have come; they go on to come meanwhile."""

    stop_after = -1

    def receive(self, timeout_s):
        self.stop_after -= 1
        if self.stop_after == 0:
            self.now_s += 30.0
            return None  # the wait is over, and nobody has looked at the link yet
        return super().receive(timeout_s)


@pytest.mark.parametrize("at", range(30, 42))
def test_half_a_minute_in_which_the_process_is_stopped_costs_no_cycle(monkeypatch, at):
    link = Stopped()
    told_by(link, monkeypatch)
    session = Session(link, "virtual", ROOM)
    link.deliver(heartbeat())
    session.find()
    for cycle in range(320):
        for place, message in enumerate(MESSAGES[cycle]):
            link.deliver(message, after_s=0.1 * cycle + 1e-3 * place)
    link.stop_after = at
    reports = list(itertools.islice(session.reports(), 320))
    assert [report.cycle for report in reports] == list(range(320))
    assert sum(report.lost(8) for report in reports) == 0
    assert (session.assembler.late, session.assembler.orphans) == (0, 0)


MESSAGES = [cycle_messages(cycle) for cycle in range(320)]


def test_a_silence_is_waited_for_and_the_sensor_set_again(virtual, capsys):
    link, session = virtual(parameters={28: 10})
    link.reconnects = True
    link.deliver(heartbeat())
    session.start()
    for message in cycle_messages(4):
        link.deliver(message)
    for message in cycle_messages(5):
        link.deliver(message, after_s=100.0)
    reports = session.reports()
    assert next(reports).cycle == 4
    link.parameters[5] = 0
    assert next(reports).cycle == 5
    assert link.parameters[5] == 8
    assert capsys.readouterr().err.count("sensor 100 has been silent for 10 s; waiting for it") == 1


def test_nothing_is_ever_sent_to_a_bus_that_is_only_listened_to(virtual, monkeypatch):
    monkeypatch.setattr(VirtualLink, "listen_only", True)
    link, session = virtual()
    for cycle in range(20):
        for message in [*cycle_messages(cycle), heartbeat(node=3, role=0)]:
            link.deliver(message, after_s=0.1 * cycle)
    link.deliver(heartbeat(state=0), after_s=2.0)
    assert session.start({9: 1}) is False
    assert session.node == NODE
    reports = session.reports()
    assert [next(reports).cycle for _ in range(20)] == list(range(20))
    assert next_or_none(reports) is None
    assert link.requests == []


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
    assert link.now_s - begin_s == pytest.approx(finding.SILENCE_S, abs=0.051)


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
    while (message := session.receiver.receive(1.0)) is None or message.name != "HEARTBEAT":
        pass
    assert session.receiver.bad_frames == 2
    assert session.receiver.traffic[WRONG_LENGTH] == session.receiver.traffic[MEANINGLESS] == 1
    sender.close()
    source.close()

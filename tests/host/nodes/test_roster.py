"""What a roster makes of messages, in any order, of this protocol or another."""

import can
import pytest

from goldfield.errors import UserError
from goldfield.nodes.drive_health import CAUSES
from goldfield.nodes.elements import elements_of, parsed, shown
from goldfield.nodes.roster import ECHO_S, Roster
from goldfield_protocol import encode
from goldfield_protocol.messages import database
from tests.host.fake_sensor import cycle_messages, heartbeat


def raw(message, **fields):
    identifier, data = message
    return can.Message(arbitration_id=identifier, data=data, **fields)


def roster_of(*messages):
    roster = Roster()
    for time_s, message in enumerate(messages):
        roster.take(raw(message), float(time_s))
    return roster


def test_a_node_is_what_it_last_said():
    counter = encode("COUNTER", {"counter": 5, "value": 7}, node=100, index=5)
    node = roster_of(heartbeat(state=1), counter, *cycle_messages(3), heartbeat(state=3)).nodes[100]
    assert (node.role, node.state, node.version, node.same_protocol) == ("sensor", "running", "0.1.0", True)
    assert (node.counters, node.locked, node.temperature_degC) == ({5: 7}, True, 25)
    assert (node.first_s, node.heard_s, node.messages) == (0.0, 13.0, 14)


def test_a_restart_forgets_what_was_counted():
    counter = encode("COUNTER", {"counter": 5, "value": 7}, node=100, index=5)
    assert roster_of(counter, heartbeat(state=0)).nodes[100].counters == {}


HEALTH = {
    **{"cause": 7, "locked_out": 0, "headroom_lost": 0, "trips": 2, "wait": 1, "supply": 95.0},
    **{"coil_temperature": 121.5, "driver_temperature": 40.0, "rms": 8.0, "direct": 0.003},
}


def test_how_a_drive_fares_is_told_in_words_with_what_to_do():
    health = roster_of(heartbeat(), encode("DRIVE_HEALTH", HEALTH, node=100)).nodes[100].health[0]
    assert (health.cause, health.trips, health.wait_s) == ("coil_hot", 2, 1)
    assert (health.supply_V, health.coil_degC, health.driver_degC) == (95.0, 121.5, 40.0)
    assert health.reason is not None
    assert "warmer than the parameter coil_hot" in health.reason
    assert health.remedy(5) == "when that is mended: goldfield nodes clear 5"


def test_every_cause_of_the_protocol_has_words():
    signal = database().get_message_by_name("DRIVE_HEALTH").get_signal_by_name("cause")
    assert {"none", *CAUSES} == {str(name) for name in signal.choices.values()}


def test_a_drive_that_is_locked_out_needs_its_power_taken():
    message = encode("DRIVE_HEALTH", {**HEALTH, "locked_out": 1, "trips": 5}, node=100)
    health = roster_of(heartbeat(), message).nodes[100].health[0]
    assert "5 times in a row" in health.remedy(5)
    assert "power the board off" in health.remedy(5)


def test_nothing_keeps_a_healthy_drive_off():
    message = encode("DRIVE_HEALTH", {**HEALTH, "cause": 0}, node=100)
    assert roster_of(heartbeat(), message).nodes[100].health[0].reason is None
    assert roster_of(message, heartbeat(state=0)).nodes[100].health == {}


def test_of_a_node_with_another_protocol_nothing_else_is_understood():
    node = roster_of(heartbeat(hash_=0x1234), *cycle_messages(0)).nodes[100]
    assert (node.same_protocol, node.locked) == (False, None)


@pytest.mark.parametrize(("second", "count"), [({"role": 0}, 1), ({"role": 1}, 0), ({"role": 0, "state": 0}, 0)])
def test_two_boards_of_one_number_contradict_each_other(second, count):
    assert roster_of(heartbeat(), heartbeat(**second)).nodes[100].contradictions == count


def test_foreign_traffic_is_counted_by_kind():
    roster = Roster()
    roster.take(raw((0x123, b"\0"), is_extended_id=False), 0.0)
    roster.take(raw((0x18FEF100, bytes(8))), 0.0)  # J1939
    roster.take(raw((0x11000064, bytes(3))), 0.0)  # a heartbeat of the wrong length
    assert roster.nodes == {}
    assert sum(roster.others.values()) == 3


def test_requests_of_another_host_are_told_from_echoes_of_our_own():
    request = encode("PARAM_SET", {"kind": 0, "value_unsigned": 3}, node=100, index=5)
    roster = Roster()
    roster.sent(*request, 0.0)
    roster.take(raw(request), 0.1)
    roster.take(raw(request), ECHO_S)
    assert roster.requests_of_others == []
    roster.take(raw(encode("PARAM_SET", {"kind": 0, "value_unsigned": 4}, node=100, index=5)), 0.2)
    roster.take(raw(request), 0.1 + ECHO_S)
    assert [message.signals["value_unsigned"] for message in roster.requests_of_others] == [4, 3]


@pytest.mark.parametrize(
    ("text", "name", "elements"),
    [
        ("amplitude", "amplitude", [0]),
        ("code_list[3]", "code_list", [3]),
        ("beacons[2]", "beacons", list(range(16, 24))),
        ("beacons[2][6]", "beacons", [22]),
        ("half_space", "half_space", list(range(6))),
    ],
)
def test_names_of_parameters_and_their_elements(text, name, elements):
    parameter, found = elements_of(text)
    assert (parameter.name, list(found)) == (name, elements)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("amplitud", "nearest is 'amplitude'"),
        ("amplitude[0]", "no elements of elements"),
        ("code_list[64]", r"write code_list\[0..63\]"),
        ("beacons[64]", "no such element"),
        ("beacons[1][8]", "no such element"),
        ("code_list[x]", "is no parameter"),
    ],
)
def test_what_is_no_parameter(text, said):
    with pytest.raises(UserError, match=said):
        elements_of(text)


def test_values_are_checked_as_a_board_checks_them():
    amplitude, _ = elements_of("amplitude")
    assert parsed(amplitude, 0, "15.9") == pytest.approx(15.9)
    for text, said in (("16", "0 to 15.9 A"), ("nan", "0 to 15.9 A"), ("much", "must be a number")):
        with pytest.raises(UserError, match=said):
            parsed(amplitude, 0, text)
    code, _ = elements_of("code")
    assert parsed(code, 0, "0x10") == 16
    with pytest.raises(UserError, match="a whole number, 0 to 2048"):
        parsed(code, 0, "1.5")


def test_values_are_shown_with_one_unit_or_none():
    amplitude, elements = elements_of("amplitude")
    assert shown(amplitude, elements, [8.0]) == "8 A"
    half_space, elements = elements_of("half_space")
    assert shown(half_space, elements[:2], [1.0, None]) == "1, - m"
    assert shown(half_space, elements, [1.0, 2.0, 3.0, 0.0, 0.0, 1.0]) == "1, 2, 3, 0, 0, 1"


def test_the_answer_of_another_host_to_a_challenge_is_no_message_of_the_node_it_goes_to():
    roster = Roster()
    roster.take(raw(encode("ACCESS", {"low": 1, "high": 2}, node=100, index=1)), 0.0)
    assert ([one.name for one in roster.requests_of_others], list(roster.nodes)) == (["ACCESS"], [])
    roster.take(raw(encode("ACCESS", {"low": 1, "high": 2}, node=100, index=0)), 0.1)
    assert (len(roster.requests_of_others), list(roster.nodes)) == (1, [100])

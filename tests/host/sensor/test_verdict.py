"""What boards say of themselves, on both sides of every threshold, and what it does to fields and poses."""

import dataclasses
import math

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.link.reports import Report
from goldfield.locate import locate
from goldfield.sensor import verdict as verdicts
from goldfield.sensor.amendment import amended_fields, amended_pose
from goldfield.sensor.health import CODE, LONGEST_STEP_S, WAVEFORM, Health
from goldfield.sensor.verdict import Verdict, judge
from goldfield.types import Explanation, Fields, Finding, Pose, Status
from goldfield_protocol import decode, encode
from tests.host.fake_sensor import CODES, CYCLE_S, NODE, SITE, beacon_fields, heartbeat

ROOM = sites.load(SITE)
IDS = tuple(beacon.id for beacon in ROOM.beacons)
GOOD = {"over_current": 0, "open_coil": 0, "driver_fault": 0, "enabled": 1, "locked": 1, "phase": 0}


def drive(node, current=10.0, target=10.0, index=0, **flags):
    signals = GOOD | {"current": current, "reference": current, "target": target} | flags
    return encode("DRIVE_STATUS", signals, node=node, index=index)


def answer(node, parameter, value, status=0):
    signals = {"kind": 0, "status": status, "value_unsigned": value}
    return encode("PARAM_VALUE", signals, node=node, index=parameter)


def sync(node, cycle=0):
    return encode("SYNC", {"cycle": cycle, "chips": 1023, "chip_period": 97750.0, "rank": 1}, node=node)


class Bus:
    """A sensor and eight beacons, node n with the code of the n-th beacon of the room; all is well."""

    def __init__(self, codes=CODES):
        self.health = Health(CYCLE_S)
        self.health.node = NODE
        self.cycle = 0
        self.quiet = set()
        self.say(heartbeat())
        for node, code in enumerate(codes, start=1):
            self.say(heartbeat(node=node, role=0), answer(node, CODE, code), answer(node, WAVEFORM, 0), drive(node))
        self.say(sync(1))
        self.report = Report(0, chips=1023, saturated=0, announced=8, locked=True)
        self.report.correlation_T.update((code, np.ones(3)) for code in codes)

    def say(self, *messages):
        for message in messages:
            self.health.take(decode(*message))

    def header(self, cycle=None, time_s=None, locked=1):
        cycle = self.cycle if cycle is None else cycle
        time_s = (cycle + 0.5) * CYCLE_S if time_s is None else time_s
        self.say(encode("EPOCH", {"cycle": cycle, "time": time_s}, node=NODE))
        status = {"cycle_low": cycle % 16, "chips": 1023, "saturated": 0, "fields": 8, "phase": 0, "temperature": 25}
        self.say(encode("EPOCH_STATUS", status | {"locked": locked}, node=NODE))

    def run(self, cycles, quiet=(), **changes):
        """Let cycles pass in which all but the quiet nodes send what they always send."""
        for _ in range(cycles):
            self.cycle += 1
            self.header()
            self.say(*(drive(node) for node in range(1, 9) if node not in quiet))
            self.say(*(sync(1, self.cycle) for _ in range("sync" not in quiet)))
        return self.judge()

    def judge(self, **changes):
        return judge(self.health, dataclasses.replace(self.report, **changes), ROOM)


@pytest.fixture
def bus():
    bus = Bus()
    bus.run(3)
    return bus


def texts(verdict):
    return [finding.text for finding in verdict.findings]


def test_nothing_is_told_when_all_is_well(bus):
    assert bus.judge() == Verdict()
    assert bus.run(100) == Verdict()


def test_a_serial_line_tells_of_the_sensor_only():
    bus = Bus(codes=())
    for cycle in range(60):
        bus.header(cycle)
    assert bus.judge(correlation_T=dict.fromkeys(CODES, np.ones(3))) == Verdict(notes=("no SYNC, clocks in hold-over",))


# ---- The time ----


def test_an_unlocked_sensor_is_inconsistent_at_once_and_no_longer(bus):
    verdict = bus.judge(locked=False)
    assert verdict.inconsistent
    assert [(finding.kind, finding.text) for finding in verdict.findings] == [
        (
            Explanation.CLOCK,
            "the clock of sensor 100 is not locked: check its sync wire or bus, and the sync master",
        )
    ]
    assert bus.judge(locked=True) == Verdict()


@pytest.mark.parametrize(("last", "inconsistent"), [(0, True), (1, False)])
def test_a_report_without_status_is_as_the_latest_status_was(bus, last, inconsistent):
    bus.header(4, locked=last)
    assert bus.judge(locked=None).inconsistent == inconsistent


def test_hold_over_is_a_note(bus):
    cycles = math.floor(verdicts.SYNC_MISSED_S / CYCLE_S)
    assert bus.run(cycles, quiet=["sync"]) == Verdict()
    verdict = bus.run(1, quiet=["sync"])
    assert (verdict.notes, verdict.findings, verdict.inconsistent) == (("no SYNC, clocks in hold-over",), (), False)


def test_two_masters_count_until_one_is_silent_for_three_seconds(bus):
    bus.say(sync(3))
    assert bus.judge() == Verdict()  # It may have taken over.
    verdict = bus.run(1)
    assert verdict.inconsistent
    assert texts(verdict) == ["nodes 1 and 3 are both sync masters: set sync_master = 1 in one board only"]
    cycles = math.floor(verdicts.EVENT_S / CYCLE_S)
    assert bus.run(cycles - 1).inconsistent
    assert bus.run(1) == Verdict()


def test_a_deputy_that_takes_over_is_no_second_master(bus):
    assert bus.run(3, quiet=["sync"]) == Verdict()
    for _ in range(40):
        bus.say(sync(3))
        assert bus.run(1, quiet=["sync"]) == Verdict()
    bus.say(sync(1))  # The master is back, and follows from its next SYNC on.
    assert bus.judge() == Verdict()


@pytest.mark.parametrize(("a_second", "told"), [(2, False), (3, True), (10, True)])
@pytest.mark.parametrize("node", [NODE, 4])
def test_edges_of_a_second_master_on_the_wire_are_told_after_two_seconds(bus, a_second, told, node):
    """By the count of any board; it costs no status, since the wire may also be disturbed."""
    verdicts_of = []
    for second in range(4):
        bus.say(rejected(node, 7 + a_second * second))
        verdicts_of.append(bus.run(10))
    assert [bool(verdict.findings) for verdict in verdicts_of] == [False, False, told, told]
    assert not any(verdict.inconsistent for verdict in verdicts_of)
    if told:
        assert texts(verdicts_of[-1])[0].startswith(
            f"edges of the sync wire come at wrong times all along, as node {node}"
        )
        bus.say(rejected(node, 7 + a_second * 3))
        bus.run(math.ceil(verdicts.EVENT_S / CYCLE_S) - 10)
        assert bus.run(1).findings == ()


def test_edges_that_are_rejected_once_are_not_told(bus):
    """A clock that changes to another master rejects three, a disturbance any number."""
    for count in (0, 500, 500, 510, 510):
        bus.say(rejected(NODE, count))
        assert bus.run(10).findings == ()


def rejected(node, count):
    return encode("COUNTER", {"counter": 10, "value": count}, node=node, index=10)


def test_two_sensors_of_one_number_count_while_both_are_heard(bus):
    bus.header(3, time_s=3.5 * CYCLE_S + 0.01)
    verdict = bus.judge()
    assert verdict.inconsistent
    assert "come twice and differently: two boards have the number 100" in verdict.findings[0].text
    assert bus.run(math.floor(verdicts.EVENT_S / CYCLE_S) - 1).inconsistent
    assert bus.run(2) == Verdict()


@pytest.mark.parametrize(("locked", "told"), [(0, False), (1, True)])
def test_a_count_that_begins_twice_before_the_clock_is_locked_is_no_second_board(locked, told):
    """So an emulated sensor started that was read from its first cycle on: the third number fits the first count."""
    bus = Bus()
    for cycle, time_s in ((0, 0.049999), (0, 0.149997), (3, 0.348750)):
        bus.header(cycle, time_s, locked)
    for cycle in range(4, 7):
        bus.header(cycle, 0.348750 + (cycle - 3) * CYCLE_S)
    assert any("come twice and differently" in text for text in texts(bus.judge())) == told


def test_two_boards_of_one_number_and_different_roles(bus):
    bus.say(heartbeat(role=3))
    bus.run(2)
    assert bus.judge() == Verdict()  # it might have been flashed anew
    bus.say(heartbeat(role=1))
    assert bus.judge().inconsistent


@pytest.mark.parametrize(("locked", "told"), [(1, True), (0, False)])
def test_numbers_that_jump_in_a_locked_sensor(bus, locked, told):
    """A sensor that is not locked yet gets its number from the first SYNC: that is no fault, and it is told as that."""
    bus.header(4, locked=locked)
    bus.header(2, time_s=5.5 * CYCLE_S)
    assert any("numbers of the cycles" in text for text in texts(bus.judge())) == told
    assert bus.judge().inconsistent == told
    for i in range(1, 11):
        bus.header(2 + i, time_s=(5.5 + i) * CYCLE_S)
        bus.say(*map(drive, range(1, 9)))
    assert bus.judge().inconsistent == told
    bus.header(13, time_s=16.5 * CYCLE_S)
    bus.say(sync(1))
    assert not bus.judge().inconsistent


def test_a_restart_of_the_sensor_is_told_for_a_second_and_costs_nothing(bus):
    bus.say(heartbeat(state=0))
    verdict = bus.judge()
    assert (texts(verdict), verdict.inconsistent) == (["sensor 100 restarted: check its power"], False)
    assert texts(bus.run(math.floor(verdicts.JUMP_S / CYCLE_S))) == texts(verdict)
    assert bus.run(1) == Verdict()


def test_a_sensor_without_its_crystal(bus):
    bus.say(heartbeat(state=5))
    assert bus.judge().inconsistent


def test_the_clock_takes_half_a_second_of_a_gap(bus):
    before = bus.health.now_s
    bus.header(4 + 1000)
    assert bus.health.now_s == pytest.approx(before + LONGEST_STEP_S)
    bus.header(4, time_s=0.05)
    assert bus.health.now_s == pytest.approx(before + LONGEST_STEP_S)


# ---- Announced fields ----


def test_codes_that_are_not_the_sites(bus):
    foreign = dict.fromkeys((*CODES, 77), np.ones(3))
    verdict = bus.judge(announced=9, correlation_T=foreign)
    assert texts(verdict) == ["the sensor reports code 77, which the site has not: check the site and the sensor"]
    verdict = bus.judge(announced=7, correlation_T=dict.fromkeys(CODES[1:], np.ones(3)))
    assert texts(verdict) == ["the sensor reports 7 of the site's 8 codes: its code list was changed"]
    assert verdict.findings[0].beacons == IDS[:1]
    assert not verdict.inconsistent


# ---- Beacons ----

FAULTS = [
    ({"open_coil": 1}, "an open coil: check coil and cable, then goldfield nodes clear"),
    ({"over_current": 1}, "over-current: look for a short in coil and cable, then goldfield nodes clear"),
    ({"driver_fault": 1}, "a driver fault: check supply and coil, then goldfield nodes clear"),
    ({"locked": 0}, "a clock that is not locked: check the sync wire or the CAN bus, and the sync master"),
    (
        {"target": 0.0, "current": 0.0, "enabled": 0},
        "an amplitude of 0 A: give it one with goldfield nodes set, or start it with goldfield nodes start",
    ),
    ({"enabled": 0}, "a bridge that is off: goldfield doctor tells why"),
]


@pytest.mark.parametrize(("flags", "text"), FAULTS)
def test_a_beacon_whose_board_reports_a_fault_is_left_out(bus, flags, text):
    bus.say(drive(2, **flags))
    verdict = bus.judge()
    assert (verdict.out, verdict.inconsistent) == (IDS[1:2], False)
    assert [(f.kind, f.beacons, f.text) for f in verdict.findings] == [
        (Explanation.BOARD, IDS[1:2], f"{IDS[1]}'s board (node 2) reports {text}")
    ]
    bus.say(drive(2), drive(2))
    assert bus.judge() == Verdict()


def test_one_sentence_for_all_who_have_the_same(bus):
    bus.say(*(drive(node, locked=0) for node in (2, 4, 5)))
    verdict = bus.judge()
    assert verdict.out == (IDS[1], IDS[3], IDS[4])
    assert texts(verdict) == [f"the boards of {IDS[1]}, {IDS[3]} and {IDS[4]} report {FAULTS[3][1]}"]


@pytest.mark.parametrize(("state", "out"), [(3, False), (4, True), (5, True)])
def test_a_beacon_of_which_only_heartbeats_came(state, out):
    bus = Bus()
    bus.health.boards[2].drive = bus.health.boards[2].drive_before = None
    bus.say(heartbeat(node=2, role=0, state=state))
    bus.header(1)
    assert bool(bus.judge().out) == out


@pytest.mark.parametrize(("change", "out"), [(0.019, False), (0.021, True)])
def test_a_current_that_changes_by_two_percent_in_a_period(bus, change, out):
    bus.say(drive(2, current=10.0 / (1.0 - change)))
    assert bool(bus.judge().out) == out


def test_a_beacon_is_silent_after_two_and_a_half_seconds(bus):
    cycles = math.floor(verdicts.SILENT_S / CYCLE_S)
    assert bus.run(cycles, quiet=[2]) == Verdict()
    verdict = bus.run(1, quiet=[2])
    assert verdict.out == ()
    assert texts(verdict) == [f"{IDS[1]}'s board (node 2) is silent: check its power and its cable"]


def test_what_a_silent_board_said_last_still_holds(bus):
    bus.say(drive(2, open_coil=1))
    verdict = bus.run(30, quiet=[2])
    assert verdict.out == IDS[1:2]
    assert "silent" in texts(verdict)[0]


def test_a_beacon_whose_board_was_never_heard():
    bus = Bus(codes=CODES[:-1])
    verdict = bus.run(math.floor(verdicts.SILENT_S / CYCLE_S))
    assert texts(verdict) == []
    verdict = bus.run(2)
    assert texts(verdict) == [f"no board with the code of {IDS[-1]} is heard: check its power and cable"]


def test_a_board_that_has_yet_to_tell_its_code_may_be_the_one_that_is_missing():
    bus = Bus(codes=CODES[:-1])
    bus.say(heartbeat(node=8, role=0))
    assert texts(bus.run(30)) == []
    bus.say(answer(8, CODE, 500), answer(8, WAVEFORM, 0))
    assert texts(bus.judge()) == [f"no board with the code of {IDS[-1]} is heard: check its power and cable"]


def test_two_boards_with_one_code(bus):
    bus.say(answer(4, CODE, CODES[1]))
    verdict = bus.judge()
    assert verdict.out == IDS[1:2]
    assert f"nodes 2 and 4 both have the code of {IDS[1]}: give each board its own code" in texts(verdict)
    assert "two boards have the number 4, or its code was changed" in texts(verdict)


SHARED = dataclasses.replace(
    ROOM,
    shared_codes=True,
    beacons=(*ROOM.beacons[:-1], dataclasses.replace(ROOM.beacons[-1], code=CODES[1])),
)
"""The room, whose last beacon has the code of its second."""


def test_boards_that_share_a_code_as_the_site_says_are_sound():
    bus = Bus(codes=(*CODES[:-1], CODES[1]))
    assert judge(bus.health, bus.report, SHARED) == Verdict()
    assert judge(bus.health, bus.report, ROOM).out == IDS[1:2]  # In another room they are not.


def test_one_board_more_than_beacons_of_a_code_is_told():
    bus = Bus(codes=(*CODES[:-1], CODES[1]))
    bus.say(heartbeat(node=9, role=0), answer(9, CODE, CODES[1]), answer(9, WAVEFORM, 0), drive(9))
    verdict = judge(bus.health, bus.report, SHARED)
    assert verdict.out == (IDS[1], IDS[-1])
    assert texts(verdict) == [
        f"nodes 2, 8 and 9 all have the code of {IDS[1]} and {IDS[-1]}: give each board its own code"
    ]


def test_what_a_board_complains_of_may_be_true_of_each_beacon_of_its_code():
    bus = Bus(codes=(*CODES[:-1], CODES[1]))
    bus.say(drive(8, open_coil=1))
    verdict = judge(bus.health, bus.report, SHARED)
    assert verdict.out == (IDS[1], IDS[-1])
    assert texts(verdict) == [f"{IDS[1]} or {IDS[-1]}'s board (node 8) reports {FAULTS[0][1]}"]
    assert verdict.findings[0].beacons == (IDS[1], IDS[-1])


def test_a_fault_of_a_board_that_is_no_beacon_yet_is_told_with_its_number(bus):
    bus.say(heartbeat(node=30, role=0), drive(30, open_coil=1))
    verdict = bus.judge()
    assert (verdict.out, texts(verdict)) == ((), [f"node 30, a beacon, reports {FAULTS[0][1]}"])
    bus.say(answer(30, CODE, 500), answer(30, WAVEFORM, 0))
    assert bus.judge() == Verdict()  # it is a beacon of another site


@pytest.mark.parametrize(("waveform", "status"), [(1, 0), (0, 1)])
def test_a_board_that_drives_no_plain_code_is_no_beacon_of_the_site(waveform, status):
    bus = Bus()
    bus.say(answer(2, WAVEFORM, waveform, status), drive(2, open_coil=1))
    bus.header(1)
    assert bus.judge().out == ()


def test_the_second_channel_does_not_count(bus):
    bus.say(drive(2, index=1, open_coil=1))
    assert bus.judge() == Verdict()


def test_a_board_that_restarts_is_asked_again(bus):
    assert bus.health.boards[2].unasked == ()
    bus.say(heartbeat(node=2, role=0, state=0))
    assert bus.health.boards[2].unasked == (CODE, WAVEFORM)
    assert bus.health.boards[NODE].unasked == ()


def test_counters_are_those_since_the_reset(bus):
    bus.say(encode("COUNTER", {"counter": 12, "value": 3}, node=2, index=12))
    bus.say(encode("COUNTER", {"counter": 10, "value": 0}, node=3, index=10))
    assert bus.health.counters == {2: {12: 3}}
    bus.say(heartbeat(node=2, role=0, state=0))
    assert bus.health.counters == {}


# ---- Currents ----


@pytest.mark.parametrize(("current", "ratio"), [(10.019, None), (10.021, 1.0021), (9.979, 0.9979), (9.981, None)])
def test_a_measured_current_is_used_from_two_per_mille_on(bus, current, ratio):
    bus.say(drive(2, current=current), drive(2, current=current))
    verdict = bus.judge()
    assert verdict.ratio == ({} if ratio is None else {IDS[1]: pytest.approx(ratio)})
    assert verdict.findings == ()


@pytest.mark.parametrize(("current", "told"), [(10.19, False), (10.21, True), (9.79, True), (-12.0, True)])
def test_a_measured_current_is_told_from_two_percent_on_and_has_no_sign(bus, current, told):
    bus.say(drive(2, current=current), drive(2, current=current))
    verdict = bus.judge()
    assert verdict.ratio[IDS[1]] == pytest.approx(abs(current) / 10.0)
    assert [finding.factor for finding in verdict.findings] == ([pytest.approx(abs(current) / 10.0)] if told else [])


@pytest.mark.parametrize("current", [0.0, 0.099, -0.099])
def test_a_beacon_whose_board_measures_no_current_is_left_out(bus, current):
    """Its field was divided by nothing."""
    bus.say(drive(3, current=current), drive(3, current=current))
    verdict = bus.judge()
    assert (verdict.out, verdict.ratio) == (("b3",), {})
    assert texts(verdict) == ["b3's board (node 3) is to drive 10 A and measures none: check its coil and its cable"]
    bus.say(drive(3, current=0.101), drive(3, current=0.101))
    assert bus.judge().ratio == {"b3": pytest.approx(0.0101)}


def test_a_current_is_used_for_half_a_second(bus):
    bus.say(drive(2, current=11.0), drive(2, current=11.0))
    cycles = math.floor(verdicts.HEARD_S / CYCLE_S)
    assert bus.run(cycles, quiet=[2]).ratio
    assert bus.run(1, quiet=[2]) == Verdict()


# ---- Fields and poses ----


def fields():
    return Fields(3, 0.35, IDS, beacon_fields(), np.full(8, 2e-8))


def test_fields_are_as_they_would_be_with_the_sites_currents():
    true = fields()
    stronger = true.field_T.copy()
    stronger[2] *= 1.25
    amended = amended_fields(dataclasses.replace(true, field_T=stronger), Verdict(out=IDS[:1], ratio={IDS[2]: 1.25}))
    assert amended.beacons == IDS[1:]
    np.testing.assert_allclose(amended.field_T, true.field_T[1:], rtol=1e-12)
    np.testing.assert_allclose(amended.sigma_T, [2e-8, 1.6e-8, *[2e-8] * 5])
    assert amended_fields(true, Verdict()) is true


def test_a_pose_gets_worse_only():
    pose = dataclasses.replace(locate(ROOM, fields()), reason=None)
    finding = Finding(Explanation.CLOCK, (), "the clock is off")
    for status in Status:
        own = dataclasses.replace(pose, status=status, reason="one")
        worse = amended_pose(own, Verdict(findings=(finding,), inconsistent=True))
        assert worse.status is (Status.FAILED if status is Status.FAILED else Status.INCONSISTENT)
        assert (worse.reason, worse.findings[0]) == ("the clock is off; one", finding)
        told = amended_pose(own, Verdict(findings=(finding,)))
        assert (told.status, told.protection_m) == (status, own.protection_m)
    assert amended_pose(pose, Verdict(findings=(finding,))).reason == "the clock is off"
    assert amended_pose(pose, Verdict(findings=(finding,), inconsistent=True)).protection_m == math.inf
    assert amended_pose(pose, Verdict(ratio={IDS[0]: 1.001})) is pose
    failed = Pose.failed(fields())
    assert math.isnan(amended_pose(failed, Verdict(findings=(finding,), inconsistent=True)).protection_m)


def test_a_pose_that_the_sensor_computed_cannot_leave_out():
    pose = locate(ROOM, fields())
    verdict = Verdict(out=IDS[:1], findings=(Finding(Explanation.BOARD, IDS[:1], "an open coil"),))
    assert amended_pose(pose, verdict).excluded == (*pose.excluded, IDS[0])
    own = amended_pose(pose, verdict, used_all=True)
    assert (own.status, own.excluded) == (Status.UNVERIFIED, pose.excluded)

"""The host beside a sensor that chooses its codes: what it sets, what it refuses, what it tells."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from goldfield.access.gold import code_matrix
from goldfield.cli.entry import build_parser
from goldfield.cli.link_options import reading
from goldfield.errors import UserError
from goldfield.link.reports import Report
from goldfield.sensor.dialogue import STRONGEST, wanted_parameters
from goldfield.sensor.health import Health
from goldfield.sensor.options import Method, Options
from goldfield.sensor.session import Session
from goldfield.sensor.strangers import PATIENCE, Strangers
from goldfield.sensor.verdict import judge
from goldfield.site import load
from tests.host.fake_sensor import CODES, NODE, SITE, cycle_messages, heartbeat
from tests.host.virtual_link import VirtualLink, told_by

ROOM = load(SITE)


def test_a_list_switches_the_choice_off_and_a_choice_leaves_the_list():
    listed = wanted_parameters(CODES)
    assert listed[STRONGEST] == 0
    assert [listed[256 + i] for i in range(8)] == list(CODES)
    assert wanted_parameters(None, {STRONGEST: 6}) == {STRONGEST: 6}
    assert wanted_parameters(CODES, {STRONGEST: 6})[STRONGEST] == 6


def test_too_many_beacons_for_a_list_are_told_of_the_choice():
    with pytest.raises(UserError, match=r"65 beacons, a sensor reports 64 of a list at most: split .*strongest"):
        wanted_parameters(range(65))


@pytest.mark.parametrize(
    ("options", "degree", "text"),
    [
        (Options(strongest=0), 10, "chooses 1 to 64 codes of degree 10"),
        (Options(strongest=65), 10, "chooses 1 to 64 codes of degree 10"),
        (Options(strongest=17), 7, "chooses 1 to 16 codes of degree 7"),
        (Options(Method.TRACK, rate_hz=30.0, strongest=6), 10, "both given: poses between the cycles"),
        (Options(Method.TRACK, lag_s=0.05, strongest=6), 10, "both given: poses between the cycles"),
    ],
)
def test_what_is_refused(options, degree, text):
    with pytest.raises(UserError, match=text):
        options.check(dataclasses.replace(ROOM, degree=degree))


@pytest.mark.parametrize(("strongest", "degree"), [(1, 10), (64, 10), (16, 7), (4, 5), (None, 10)])
def test_what_is_taken(strongest, degree):
    Options(strongest=strongest).check(dataclasses.replace(ROOM, degree=degree))


def test_a_beacon_with_the_code_that_is_never_chosen():
    last = dataclasses.replace(ROOM.beacons[-1], code=1024)
    site = dataclasses.replace(ROOM, beacons=(*ROOM.beacons[:-1], last))
    with pytest.raises(UserError, match="never chooses code 1024"):
        Options(strongest=6).check(site)


def heard(*codes):
    """Return a report of fields of 50 nT, and what an ambient field of 50 uT leaves in their correlations: 50 nT."""
    report = Report(1, announced=len(codes), offset_T=np.array([0.0, 5e-5, 0.0]))
    means = code_matrix(10, codes).mean(axis=0)
    report.correlation_T = {
        code: np.array([3e-8, 0.0, -4e-8]) + mean * report.offset_T for code, mean in zip(codes, means, strict=True)
    }
    return report


def test_a_stranger_is_told_once_when_it_stays():
    told = []
    strangers = Strangers(ROOM, told.append)
    for _ in range(PATIENCE - 1):
        strangers.take(heard(*CODES[:3], 77))
    strangers.take(heard(*CODES[:3]))  # It was noise, or went.
    for _ in range(PATIENCE - 1):
        strangers.take(heard(77))
    assert told == []
    strangers.take(Report(1))  # Nothing arrived.
    strangers.take(heard(77))
    assert told == ["code 77 is heard, 50 nT, and is no beacon of the site"]
    for _ in range(3 * PATIENCE):
        strangers.take(heard(77, 78))
    assert [text[:8] for text in told] == ["code 77 ", "code 78 "]


def test_what_the_sensor_chose_is_no_fault():
    report = heard(*CODES[:5], 77)
    assert any("reports code 77" in finding.text for finding in judge(Health(0.1), report, ROOM).findings)
    assert not judge(Health(0.1), report, ROOM, chosen=True).findings
    assert not judge(Health(0.1), heard(*CODES[:5]), ROOM, chosen=True).findings
    assert judge(Health(0.1), heard(*CODES[:5]), ROOM).findings


@pytest.fixture
def virtual(monkeypatch):
    link = VirtualLink(parameters={28: 10})
    told_by(link, monkeypatch)
    link.deliver(heartbeat())
    session = Session(link, "virtual", ROOM, strongest=6)
    return link, session


def test_the_session_sets_the_choice_and_nothing_of_the_list(virtual):
    link, session = virtual
    assert session.start()
    assert link.parameters == {28: 10, STRONGEST: 6}
    assert session.strongest == 6
    link.deliver(heartbeat())
    assert not session.start()


@pytest.mark.parametrize(("value", "put_back"), [(6, False), (0, True)])
def test_another_host_that_ends_the_choice_is_noticed(virtual, capsys, value, put_back):
    """It was set on the serial port, which nobody hears: reports of eight codes are more than six."""
    link, session = virtual
    session.start()
    link.parameters[STRONGEST] = value
    for cycle in range(30):
        for identifier, data in cycle_messages(cycle):
            link.deliver((identifier, data), 0.1 * cycle)
    reports = session.reports()
    for _ in range(25):
        next(reports)
    assert link.parameters[STRONGEST] == 6
    assert ("another host has set strongest" in capsys.readouterr().err) == put_back
    assert link.requests.count(("PARAM_SET", STRONGEST)) == 1 + put_back


def test_the_word_of_the_sensor_counts_in_a_recording(virtual):
    link, session = virtual
    assert session.strongest == 6  # asked for
    session.start()
    link.parameters[STRONGEST] = 3
    session.dialogue.ask(STRONGEST)
    assert session.strongest == 3
    assert session.node == NODE


@pytest.mark.parametrize("command", ["run", "view"])
def test_the_command_line_asks_for_it(command):
    parser = build_parser(every=True)
    words = [command, "--port", "/dev/ttyUSB0", "--site", "room.toml"]
    assert reading(parser.parse_args(words)).strongest is None
    assert reading(parser.parse_args([*words, "--strongest", "6"])).strongest == 6

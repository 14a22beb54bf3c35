"""A sensor that is not heard at the start is waited for, or not, as the user wants; all in virtual time."""

import pytest

from goldfield import site as sites
from goldfield.cli import link_options
from goldfield.cli.entry import build_parser
from goldfield.errors import SystemFailure
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import finding, samples
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Sensor
from goldfield.sensor.session import Session
from goldfield_protocol import encode
from tests.host.fake_sensor import CODES, NODE, SITE, heartbeat
from tests.host.virtual_link import VirtualLink, told_by

ROOM = sites.load(SITE)
LATE_S = 100.0
"""Later than any wait for a sensor."""


@pytest.fixture
def link_of(monkeypatch):
    """Return a function that makes a link in virtual time, whose sensor is heard so late and works with degree 10."""

    def make(heard_s, **options):
        link = VirtualLink(parameters={28: 10}, **options)
        told_by(link, monkeypatch)
        link.deliver(heartbeat(), after_s=heard_s)
        link.deliver(heartbeat(), after_s=heard_s + 1.0)
        return link

    return make


def test_a_sensor_that_gets_its_power_late_is_waited_for(link_of, capsys):
    link = link_of(LATE_S)
    sensor = Sensor(link, "late", ROOM, Options(reconnect=True, awaits=True))
    assert [link.parameters[256 + i] for i in range(8)] == list(CODES)
    told = "goldfield: late: no heartbeat of a sensor in 10 s; heard nothing: check the power, the cable and the port"
    assert capsys.readouterr().err == f"{told}; waiting for it\n", "told once, though it was looked for many times"
    assert sensor.live


def test_it_is_waited_for_while_others_are_heard(link_of, capsys):
    """As on a simulated bench that is slower than the wall clock by a hundred times: the heartbeat takes that long."""
    link = link_of(LATE_S)
    for number in range(50):
        link.deliver(heartbeat(node=3, role=0), after_s=2.0 * number)
    Sensor(link, "late", ROOM, Options(reconnect=True, awaits=True))
    assert "no heartbeat of a sensor in 30 s; heard only beacon 3; waiting for it" in capsys.readouterr().err


def test_a_sensor_that_does_not_answer_yet_is_waited_for(link_of, capsys):
    link = link_of(0.0, deaf=2 * dialogues.TRIES)
    for number in range(30):
        link.deliver(heartbeat(), after_s=1.0 * number)
    Sensor(link, "deaf", ROOM, Options(reconnect=True, awaits=True))
    assert [link.parameters[256 + i] for i in range(8)] == list(CODES)
    err = capsys.readouterr().err
    assert err.count("did not answer a request for parameter degree in 5 tries; waiting for it") == 1


def test_nobody_waits_who_did_not_say_so(link_of):
    link = link_of(LATE_S)
    begin_s = link.now_s
    with pytest.raises(SystemFailure, match="no heartbeat of a sensor in 10 s"):
        Sensor(link, "late", ROOM, Options(reconnect=True))
    assert link.now_s - begin_s == pytest.approx(finding.SILENCE_S)


def test_a_sensor_that_refuses_is_not_asked_again_and_again(link_of, monkeypatch):
    link = link_of(0.0)

    def refuse(identifier, data):
        link.deliver(encode("PARAM_VALUE", {"status": 2, "kind": 0, "value_unsigned": 0}, node=NODE, index=28))

    monkeypatch.setattr(link, "send", refuse)
    with pytest.raises(SystemFailure, match="sensor 100 says that"):
        Sensor(link, "refusing", ROOM, Options(reconnect=True, awaits=True))


@pytest.mark.parametrize("awaits", [True, False])
def test_samples_wait_alike(link_of, monkeypatch, capsys, awaits):
    link = link_of(LATE_S)
    monkeypatch.setattr(VirtualLink, "reconnects", awaits)
    cycles = samples.sample_cycles(Session(link, "late", ROOM), ROOM)
    for chip in range(2 * 1023):  # the second cycle ends the first
        signals = {"x": 1, "y": 1, "z": 1, "cycle_low": chip // 1023}
        message = encode("CHIP", signals, node=NODE, index=chip % 1023)
        link.deliver(message, after_s=LATE_S + 2.0 + 1e-4 * chip)
    if awaits:
        assert next(cycles).shape == (1023, 3)
        assert capsys.readouterr().err.count("waiting for it") == 1
    else:
        with pytest.raises(SystemFailure, match="no heartbeat of a sensor in 10 s"):
            next(cycles)


@pytest.mark.parametrize(
    ("words", "awaits"),
    [
        (["run", "--reconnect"], True),
        (["run"], False),
        (["monitor", "--reconnect"], True),
        (["view"], False),  # it opens the sensor again and again by itself, and the page says so
    ],
)
def test_the_switch_says_so(words, awaits):
    arguments = build_parser(words[0]).parse_args([*words, "--port", "x", "--site", str(SITE)])
    assert link_options.reading(arguments).awaits is awaits

"""The whole chain on host boards whose links are slow: the sensor is set up, poses come, and what is less is said."""

from __future__ import annotations

import dataclasses
import io
import itertools
import json
import re
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.cli import main
from goldfield.link.line import Line, Link
from goldfield.nodes import conversation as conversations
from goldfield.nodes import opening
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Epoch, Fix, Sensor
from goldfield.types import Status
from goldfield_protocol.messages import type_of
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from hil_sim.scenario.parts import Links
from tests.hil.bound import check_at_the_bound
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5
CYCLE_S = 1023 * 97.75e-6
POSITION_M = [0.9, 1.2, 0.8]
CAN_500, CAN_125 = Line(Link.CAN, 500_000), Line(Link.CAN, 125_000)
SERIAL_921, SERIAL_115 = Line(Link.SERIAL, 921_600), Line(Link.SERIAL, 115_200)


class Bench:
    """The bench of eight beacons at the rate of a link, and the host on it."""

    def __init__(self, line, monkeypatch, directory):
        can = line.link is Link.CAN
        links = Links(can_bit_s=line.bit_rate) if can else Links(serial_baud=line.bit_rate)
        scenario = dataclasses.replace(load_scenario("prigge8can" if can else "prigge8"), links=links)
        self.file = directory / "site.toml"
        self.file.write_text(site_toml(scenario))
        self.site = sites.load(self.file)
        self.rig = Rig(scenario, "host")
        self.rig.advance(BOOTED_S)
        self.link = (RigLink if can else RigSerialLink)(self.rig)
        self.link.line = line
        for module in (sessions, dialogues, conversations):
            monkeypatch.setattr(module, "time", self.link)
        monkeypatch.setattr(opening, "open_link", lambda *_: self.link)

    def run(self, *words):
        """Exit code, stdout and stderr of a command."""
        self.link.read()
        out, told = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(told):
            code = main([*words, *(["--port", "/dev/x"] if self.link.line.link is Link.SERIAL else ["--can", "a:b"])])
        return code, out.getvalue(), told.getvalue()


@pytest.fixture
def bench(monkeypatch, tmp_path):
    made = []

    def make(line):
        made.append(Bench(line, monkeypatch, tmp_path))
        return made[-1]

    yield make
    for one in made:
        one.rig.close()


@pytest.mark.long
@pytest.mark.parametrize("line", [CAN_500, CAN_125, SERIAL_115], ids=str)
def test_each_cycle_is_located(bench, line):
    one = bench(line)
    with Sensor(one.link, "rig", one.site, Options()) as sensor:
        epochs = list(itertools.islice(sensor.epochs(), 20))
    truth = dict.fromkeys((epoch.pose.epoch for epoch in epochs), one.rig.truth()[-1])  # the sensor is at rest
    assert [epoch.pose.status for epoch in epochs] == [Status.OK] * 20
    assert all(epoch.report.complete for epoch in epochs)
    check_at_the_bound(one.site, [epoch.pose for epoch in epochs], truth)


@pytest.mark.long
@pytest.mark.parametrize(
    ("line", "said", "rate_Hz"),
    [
        (CAN_500, "sums of 8 codes 248 times a second, not 330, at most 75 % of CAN at 500 kbit/s", 248),
        (CAN_125, "sums of 8 codes 53 times a second, not 330, at most 75 % of CAN at 125 kbit/s", 53),
        (SERIAL_921, "", 330),
        (SERIAL_115, "the sensor sends whole cycles, 10 a second: sums of 8 codes", 10),
    ],
    ids=str,
)
def test_a_track_is_made_of_what_the_link_carries(bench, capsys, line, said, rate_Hz):
    """Poses come as often as blocks, or cycles, do."""
    one = bench(line)
    cycles, times_s = rate_Hz == 10, []
    receive = one.link.receive

    def counting(timeout_s):
        raw = receive(timeout_s)
        if raw is not None and raw.arbitration_id >> 24 == type_of("EPOCH" if cycles else "BLOCK"):
            times_s.append(one.rig.now_s)
        return raw

    one.link.receive = counting
    with Sensor(one.link, "rig", one.site, Options(Method.TRACK, rate_hz=100.0)) as sensor:
        items = list(itertools.islice(sensor.stream(), 40 if cycles else 150))
    settled_s = [time_s for time_s in times_s if time_s > times_s[-1] - 1.0]
    assert len(settled_s) == pytest.approx(rate_Hz, rel=0.25)
    told = capsys.readouterr().err
    assert said in told
    assert ("the sensor sends" in told) is bool(said)
    settled = [item.pose for item in items[len(items) // 3 :] if isinstance(item, Epoch if cycles else Fix)]
    assert len(settled) > 20
    assert all(pose.status is Status.OK for pose in settled)
    assert all(np.linalg.norm(pose.position_m - POSITION_M) < 0.05 for pose in settled)


@pytest.mark.long
@pytest.mark.parametrize(("line", "most"), [(CAN_500, 64), (CAN_125, 55), (SERIAL_115, 61)], ids=str)
def test_sensors_choose_as_many_codes_as_fit(bench, line, most):
    """On a serial line that is busy the restart behind the save tears a frame, and with it the first heartbeat."""
    one = bench(line)
    text, nodes = one.file.read_text(), itertools.count(1)
    one.file.write_text(re.sub(r"\[\[beacon\]\]", lambda _: f"[[beacon]]\nnode = {next(nodes)}", text))
    code, out, told = one.run("site", "push", str(one.file), "--strongest", "64", "--pause")
    assert code == 0, told
    assert (f"sensors report {most} of the strongest codes, not 64: " in told) is (most < 64)
    assert (f"75 % of {line}" in told or f"90 % of {line}" in told) is (most < 64)
    code, out, _ = one.run("nodes", "get", "100", "strongest", "--json")
    assert json.loads(out)["values"] == [most]


@pytest.mark.long
def test_all_boards_are_found_on_the_slowest_bus_and_on_a_line_beside_it(bench, monkeypatch):
    """A board of a slow bus answers a question to all later, on both of its links."""
    one = bench(CAN_125)
    listed = [json.loads(line) for line in one.run("nodes", "boards", "--json")[1].splitlines()]
    assert [line["node"] for line in listed] == [*range(1, 9), 100]
    assert all(line["armed"] is not None for line in listed)
    line = RigSerialLink(one.rig)
    one.link = line
    monkeypatch.setattr(opening, "open_link", lambda *_: line)
    monkeypatch.setattr(conversations, "time", line)
    (listed,) = one.run("nodes", "boards", "--json")[1].splitlines()
    assert json.loads(listed)["node"] == 100

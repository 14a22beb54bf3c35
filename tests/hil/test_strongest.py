"""A sensor that walks along twelve beacons and reports the six that it hears best: nobody tells it which."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.stats import chi2

from goldfield import site as sites
from goldfield.link.recordings import CandumpWriter
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Sensor
from goldfield.types import Status
from goldfield.view.lines import Line, line_record
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5
CYCLES = 70
STRONGEST = 6
MOTION = """[motion]
kind = "waypoints"
times_s = [0.0, 3.0, 10.0, 11.0]
positions_m = [[1.0, 0.7, 0.8], [1.0, 0.7, 0.8], [9.0, 1.3, 1.0], [9.0, 1.3, 1.0]]
rotation_vectors_rad = [[0.3, -0.2, 1.1], [0.3, -0.2, 1.1], [0.3, -0.2, 1.5], [0.3, -0.2, 1.5]]

"""


def corridor():
    """Return a scenario: beacons on both sides of a corridor, every 2 m, by turns on the floor and at the ceiling."""
    text = (ROOT / "hil_sim/scenarios/prigge8.toml").read_text(encoding="utf-8")
    text = text[: text.index("[[beacon]]")].replace("noise_T = 2.0e-7", "noise_T = 5.0e-8")
    text = text.replace("pose = 1 ", "pose = 0 ")
    text = text[: text.index("[motion]")] + MOTION + text[text.index("[coil]") :]
    for i in range(12):
        x, y, z = 2.0 * (i // 2), 2.0 * (i % 2), 1.8 * ((i // 2 + i) % 2)
        text += f'[[beacon]]\nid = "b{i + 1}"\nnode = {i + 1}\nposition_m = [{x}, {y}, {z}]\ncode = {i + 2}\n'
        text += f"crystal_ppm = {(-1) ** i * 3.0 * i}\n" + ("sync_master = true\n\n" if i == 0 else "\n")
    return text


class Bench:
    """The corridor in virtual time; each bench has the same noise."""

    def __init__(self, directory, link_of):
        path = directory / "corridor12.toml"
        path.write_text(corridor(), encoding="utf-8")
        scenario = load_scenario(str(path))
        (directory / "site.toml").write_text(site_toml(scenario), encoding="utf-8")
        self.site = sites.load(directory / "site.toml")
        self.rig = Rig(scenario, "host")
        self.rig.advance(BOOTED_S)
        self.link = link_of(self.rig)

    def epochs(self, options, count=CYCLES, recorder=None, site=None):
        with Sensor(self.link, "rig", site or self.site, options, recorder) as sensor:
            return list(itertools.islice(sensor.epochs(), count))


@pytest.fixture
def make(monkeypatch, tmp_path):
    benches = []

    def bench(link_of=RigSerialLink):
        benches.append(Bench(tmp_path, link_of))
        for module in (sessions, dialogues):
            monkeypatch.setattr(module, "time", benches[-1].link)
        return benches[-1]

    yield bench
    for one in benches:
        one.rig.close()


def codes_of(epoch):
    return frozenset(epoch.report.correlation_T)


def test_a_walk_along_the_beacons(make):
    """Hand-over without gaps, and poses that are those of a full list within what they state."""
    found, full = {}, {}
    bench = make()
    for epoch in bench.epochs(Options(strongest=STRONGEST)):
        found[epoch.pose.epoch] = epoch
    truth = {one.cycle: one.position_m for one in bench.rig.truth()}
    bench = make()
    for epoch in bench.epochs(Options()):
        full[epoch.pose.epoch] = epoch
    both = sorted(found.keys() & full.keys() & truth.keys())
    assert len(both) > CYCLES - 5
    assert len({code for cycle in both for code in codes_of(found[cycle])}) == 12
    ratios, apart = [], []
    for cycle in both:
        epoch, pose, listed = found[cycle], found[cycle].pose, full[cycle].pose
        assert len(codes_of(epoch)) == len(epoch.fields.beacons) == STRONGEST
        assert epoch.lost == 0
        assert not epoch.findings
        assert pose.status in (Status.OK, Status.UNVERIFIED)
        off = pose.position_m - truth[cycle]
        ratios.append(off @ np.linalg.solve(pose.position_cov_m2, off))
        off = pose.position_m - listed.position_m  # the list has the fields of the six, and more: its errors are part
        apart.append(off @ np.linalg.solve(pose.position_cov_m2, off))
    steps = [len(codes_of(found[a]) - codes_of(found[b])) for a, b in itertools.pairwise(both)]
    assert max(steps) <= 2
    assert 6 <= sum(steps) <= 14  # From the first six to the last: six change at least, and few come back.
    limit = chi2.ppf(0.99, 3)
    assert np.mean(np.array(ratios) > limit) < 0.06
    assert np.mean(np.array(apart) > limit) < 0.03


def test_a_stranger_is_told_once_and_located_without(make, capsys):
    """A beacon that the site has not: its code is named, and what it leaks is taken out with the others."""
    bench = make()
    less = dataclasses.replace(bench.site, beacons=tuple(b for b in bench.site.beacons if b.id != "b3"))
    epochs = bench.epochs(Options(strongest=STRONGEST), 25, site=less)
    told = capsys.readouterr().err
    assert told.count("code 4 is heard, ") == 1
    assert "and is no beacon of the site" in told
    truth = {one.cycle: one.position_m for one in bench.rig.truth()}
    for epoch in epochs[5:20]:
        assert 4 in codes_of(epoch)
        assert len(epoch.fields.beacons) == STRONGEST - 1
        off = epoch.pose.position_m - truth[epoch.pose.epoch]
        assert off @ np.linalg.solve(epoch.pose.position_cov_m2, off) < chi2.ppf(0.9999, 3)


def lines(epochs):
    return [line_record(Line(epoch.pose, epoch, epoch.lost)) for epoch in epochs]


def test_a_recording_knows_that_the_sensor_chose(make, tmp_path):
    """It holds the sensor's word for it: no option is needed to read it."""
    bench = make(RigLink)
    recorder = CandumpWriter(tmp_path / "run.log")
    live = bench.epochs(Options(strongest=STRONGEST), 15, recorder)
    recorder.close()
    with open_sensor("log", str(tmp_path / "run.log"), bench.site, Options()) as recording:
        replayed = lines(recording.epochs())
    assert replayed[: len(live)] == lines(live)


def test_a_list_again_after_a_choice(make):
    """What an earlier run has set does not stay: without the option the site's codes are reported."""
    bench = make()
    chosen = bench.epochs(Options(strongest=4), 4)
    assert {len(codes_of(epoch)) for epoch in chosen[1:]} == {4}
    listed = bench.epochs(Options(), 4)
    assert {codes_of(epoch) for epoch in listed[1:]} == {frozenset(bench.site.codes)}


def test_the_board_locates_itself_by_what_it_chose(make):
    bench = make()
    epochs = bench.epochs(Options(Method.ON_SENSOR, strongest=STRONGEST), 12)
    truth = {one.cycle: one.position_m for one in bench.rig.truth()}
    for epoch in epochs[3:10]:
        assert len(epoch.pose.used) == STRONGEST
        off = epoch.pose.position_m - truth[epoch.pose.epoch]
        # The board tells the trace alone, all of which may lie in one direction.
        assert off @ off < chi2.ppf(0.9999, 1) * np.trace(epoch.pose.position_cov_m2)


def test_a_track_follows_the_cycles(make, capsys):
    """Blocks would have now these codes, now others: none are asked for, and it is said."""
    bench = make(RigLink)
    epochs = bench.epochs(Options(Method.TRACK, strongest=STRONGEST), 20)
    assert "the sensor sends whole cycles, 10 a second, at most 1 % of CAN" in capsys.readouterr().err
    truth = {one.cycle: one.position_m for one in bench.rig.truth()}
    for epoch in epochs[5:18]:
        assert len(codes_of(epoch)) == STRONGEST
        assert np.linalg.norm(epoch.pose.position_m - truth[epoch.pose.epoch]) < 0.1

"""A recording of a live run on host boards gives the very lines of the run: as many of them, and every digit."""

import itertools

import pytest

from goldfield import site as sites
from goldfield.link.recordings import CandumpWriter
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Sensor
from goldfield.view.lines import Line, line_record
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5
CYCLES = 30


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """Return a function that boots a bench and returns it with its link and its site."""
    rigs = []

    def make(link_of):
        scenario = load_scenario("prigge8")
        (tmp_path / "site.toml").write_text(site_toml(scenario))
        rigs.append(Rig(scenario, "host"))
        rigs[0].advance(BOOTED_S)
        link = link_of(rigs[0])
        monkeypatch.setattr(sessions, "time", link)
        monkeypatch.setattr(dialogues, "time", link)
        return rigs[0], link, sites.load(tmp_path / "site.toml")

    yield make
    for rig in rigs:
        rig.close()


def lines_of(sensor, count=None):
    return [line_record(Line(epoch.pose, epoch, epoch.lost)) for epoch in itertools.islice(sensor.epochs(), count)]


@pytest.mark.parametrize("set_before", [False, True])
@pytest.mark.parametrize(
    ("link_of", "method"), [(RigLink, Method.EACH), (RigLink, Method.TRACK), (RigSerialLink, Method.EACH)]
)
def test_a_recording_gives_the_lines_of_the_live_run(bench, tmp_path, link_of, method, set_before):
    """Whether the sensor had to be set first, or reported the site's codes while it was looked for.

    A beacon that is moved keeps the history of the residuals busy, which what came before the first line would change.
    """
    rig, link, site = bench(link_of)
    if set_before:
        lines_of(Sensor(link, "rig", site, Options(method)), 15)
    recorder = CandumpWriter(tmp_path / "run.log")
    sensor = Sensor(link, "rig", site, Options(method), recorder)
    live = lines_of(sensor, CYCLES // 2)
    rig.fault(2, "coil_open")
    live += lines_of(sensor, CYCLES // 2)
    recorder.close()
    with open_sensor("log", str(tmp_path / "run.log"), site, Options(method)) as recording:
        replayed = lines_of(recording)
    assert replayed[:CYCLES] == live
    assert len(replayed) <= CYCLES + 1  # what had arrived of the cycle after the last


def test_a_sensor_that_restarts_is_replayed_as_it_was_read(bench, tmp_path):
    """It is set again, and what it reports meanwhile belongs to no pose."""
    rig, link, site = bench(RigLink)
    recorder = CandumpWriter(tmp_path / "run.log")
    sensor = Sensor(link, "rig", site, Options(), recorder)
    live = lines_of(sensor, 10)
    rig.power_cycle_sensor(0.3)
    live += lines_of(sensor, 30)
    recorder.close()
    with open_sensor("log", str(tmp_path / "run.log"), site) as recording:
        replayed = lines_of(recording)
        assert recording.link_counts == sensor.link_counts
    assert replayed[: len(live)] == live

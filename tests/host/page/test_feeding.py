"""What feeds the hub: a recording at its own pace, and a live link that fails and comes back."""

import json
import math
import threading
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest

from goldfield import site as sites
from goldfield.errors import SystemFailure, UserError
from goldfield.page import feeding
from goldfield.page.feeding import Feed, Pacing
from goldfield.page.greeting import hello
from goldfield.page.hub import Hub
from goldfield.sensor.confirmation import WHY
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Fix
from goldfield.site.model import Site
from hil_sim.clib import ROOT
from tests.host.fake_sensor import CYCLE_S, SITE, log_of
from tests.host.page.walk import BROKEN, WEAK, WEAKENED, board_messages, walk

ROOM: Site = sites.load(SITE)
IDS = [beacon.id for beacon in ROOM.beacons]
CYCLES = 100
BREAKS = 90
"""The epoch from which on a coil is open; its board says so in the next one."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("walk") / "walk.log"
    path.write_text(walk(CYCLES))
    return path


def hub_of(*, live=False):
    return Hub(hello(ROOM, "a link", live=live), ROOM.cycle_s, live=live)


def fed(log, options=None):
    """Return every message of a recording."""
    hub = hub_of()
    box = hub.open()
    Feed(hub, "log", str(log), ROOM, options or Options(), 0.0).run()
    assert json.loads(hub.state_message())["state"] == "ended"
    return [json.loads(message) for message in box.take()]


@pytest.fixture(scope="module")
def messages(log):
    return fed(log)


def of(messages, kind):
    return [message for message in messages if message["type"] == kind]


def test_the_site_is_as_its_file_says(messages):
    (first,) = of(messages, "hello")
    site = first["site"]
    assert (first["protocol"], first["live"], site["name"]) == (1, False, "prigge8")
    assert [beacon["id"] for beacon in site["beacons"]] == IDS
    for beacon in site["beacons"]:
        centre = beacon["position_m"]
        for point in beacon["wire_m"]:
            assert math.dist(point, centre) == pytest.approx(0.149, abs=2e-5)
            assert point[2] == centre[2]
            for low, value, high in zip(site["box"]["low_m"], point, site["box"]["high_m"], strict=True):
                assert low < value < high
        assert beacon["wire_m"][0] == beacon["wire_m"][-1]


def test_the_docs_name_every_key(messages):
    text = (ROOT / "docs/live_page.md").read_text()
    (first,) = of(messages, "hello")
    last, health = of(messages, "epoch")[-1], of(messages, "health")[-1]
    state = json.loads(hub_of().state_message())
    own = {"at_rate", "noise_T", "alarms"}  # the others are those of run --json, and of monitor --json
    assert own < last.keys()
    boards = next(iter(health["boards"].values()))
    for keys in (first, first["site"], first["site"]["beacons"][0], own, last["alarms"][0], boards, state):
        assert [key for key in keys if f"`{key}`" not in text] == []


def test_each_epoch_has_the_pose_that_run_gives(messages, log):
    epochs = of(messages, "epoch")
    with open_sensor("log", str(log), ROOM) as sensor:
        poses = list(sensor.poses())
    assert len(epochs) == len(poses) == CYCLES
    for epoch, pose in zip(epochs, poses, strict=True):
        assert epoch["position_m"] == pose.position_m.tolist()
        assert epoch["status"] == pose.status.value
        assert epoch["protection_m"] == pytest.approx(pose.protection_m)
    assert epochs[0]["noise_T"] == pytest.approx(2.0e-7 / math.sqrt(1023), rel=0.05)


def test_an_open_coil_is_told_as_an_alarm_once(messages):
    def told(epoch):
        return [alarm for alarm in epoch["alarms"] if IDS[BROKEN] in alarm["beacons"]]

    epochs = of(messages, "epoch")
    assert not any(told(epoch) for epoch in epochs[:BREAKS])
    alarms = {alarm["kind"]: alarm["text"] for alarm in told(epochs[-1])}
    assert "open coil" in alarms["board"]
    assert "has no field" in alarms["dead"]
    for epoch in epochs:
        texts = "; ".join(alarm["text"] for alarm in epoch["alarms"])
        assert texts.count("has no field") <= 1
    assert IDS[BROKEN] in epochs[-1]["excluded"]


def test_what_a_finding_says_no_other_alarm_repeats(messages):
    """A reason that names what may be wrong names what was found."""
    reasons = 0
    for epoch in of(messages, "epoch"):
        found = [alarm["text"] for alarm in epoch["alarms"] if alarm["kind"] != epoch["status"]]
        for alarm in epoch["alarms"]:
            if alarm["kind"] == epoch["status"]:
                reasons += 1
                assert alarm["text"] in ("no pose fits all fields", WHY)
                assert len(found) >= 2 or alarm["text"] == WHY
    assert reasons > 0


def test_health_tells_each_beacon_and_what_its_board_says(messages):
    *_, middle, last = of(messages, "health")[: BREAKS // 5] + of(messages, "health")[-1:]
    assert len(of(messages, "health")) == CYCLES / 5
    assert middle["beacons"][IDS[WEAK]]["ratio"] == pytest.approx(WEAKENED, abs=0.03)
    assert middle["beacons"][IDS[0]]["ratio"] == pytest.approx(1.0, abs=0.03)
    assert last["cycles_per_s"] == pytest.approx(1.0 / CYCLE_S)
    board = last["boards"][str(last["beacons"][IDS[BROKEN]]["node"])]
    assert board["role"] == "beacon"
    assert "an open coil" in board["complaints"]
    assert board["coil_degC"] == pytest.approx(31.0 + BROKEN + 0.2 * 9.4, abs=0.3)
    assert board["supply_V"] == pytest.approx(24.0, abs=0.05)
    counted = last["boards"][str(last["beacons"][IDS[0]]["node"])]["counters"]
    assert list(counted.values()) == [2]


def test_poses_at_a_rate_come_as_fixes(log, monkeypatch):
    with open_sensor("log", str(log), ROOM) as sensor:
        epoch = next(sensor.epochs())
    stream = [replace(epoch, at_rate=True), *(Fix(replace(epoch.pose, time_s=0.03 * n), 0.0) for n in range(3))]

    @contextmanager
    def opened(*_):
        yield SimpleNamespace(stream=lambda: iter(stream), node=100)

    monkeypatch.setattr(feeding, "open_sensor", opened)
    messages = fed(log)
    assert [one["at_rate"] for one in of(messages, "epoch")] == [True]
    assert [one["t_s"] for one in of(messages, "fix")] == [0.0, 0.03, 0.06]
    assert of(messages, "fix")[0]["position_m"] == epoch.pose.position_m.tolist()


def test_a_recording_that_holds_nothing_is_refused(tmp_path):
    empty = tmp_path / "empty.log"
    empty.write_text(log_of([]))
    with pytest.raises(UserError):
        fed(empty)


# ---- a live link ----


class Flaky:
    """Sensors that are opened one after the other: each refuses, or reads a recording and then fails, or ends."""

    def __init__(self, log, hub, *outcomes):
        self.log, self.hub, self.outcomes, self.states = log, hub, list(outcomes), []

    @contextmanager
    def open(self, kind, where, site, options, recorder, source):
        assert (source is None) == bool(self.states)  # one that is open already is taken once
        state = json.loads(self.hub.state_message())
        self.states.append((state["state"], state["text"]))
        refusal, failure = self.outcomes.pop(0)
        if refusal:
            raise refusal
        with open_sensor("log", str(self.log), site, options, recorder) as sensor:
            yield Failing(sensor, failure)


class Failing:
    """A sensor whose link fails when its recording is at its end."""

    gone = ""

    def __init__(self, sensor, failure):
        self._sensor, self._failure, self.node = sensor, failure, sensor.node

    def stream(self):
        yield from self._sensor.stream()
        if self._failure:
            raise self._failure


class NoWait(threading.Event):
    """An event that is not waited for."""

    def wait(self, timeout=None):
        return self.is_set()


def feed_live(log, monkeypatch, *outcomes):
    hub = hub_of(live=True)
    flaky = Flaky(log, hub, *outcomes)
    monkeypatch.setattr(feeding, "open_sensor", lambda *words: flaky.open(*words))
    feed = Feed(hub, "port", "/dev/ttyX", ROOM, Options(), source=SimpleNamespace())
    feed.stopped = NoWait()
    feed.run()
    return flaky, hub


@pytest.fixture
def short(tmp_path):
    path = tmp_path / "short.log"
    path.write_text(log_of(range(2), [*board_messages(0.0)]))
    return path


SILENT, GONE = SystemFailure("no heartbeat of a sensor"), SystemFailure("the port is gone")
VANISHED = UserError("/dev/ttyX: cannot be opened")


def test_a_sensor_that_is_not_heard_is_tried_again_and_told_once(short, monkeypatch, capsys):
    flaky, hub = feed_live(short, monkeypatch, (SILENT, None), (SILENT, None), (None, None))
    assert flaky.states == [("waiting", ""), ("lost", str(SILENT)), ("lost", str(SILENT))]
    assert json.loads(hub.state_message())["state"] == "ended"
    assert capsys.readouterr().err.count("no heartbeat") == 1


def test_a_link_that_fails_is_opened_again_also_where_the_port_is_gone_for_a_while(short, monkeypatch):
    flaky, _ = feed_live(short, monkeypatch, (None, GONE), (VANISHED, None), (None, None))
    assert flaky.states == [("waiting", ""), ("lost", str(GONE)), ("lost", str(VANISHED))]


def test_a_port_that_was_never_there_ends_the_command(short, monkeypatch):
    with pytest.raises(UserError, match="cannot be opened"):
        feed_live(short, monkeypatch, (VANISHED, None))


# ---- the pace ----


class Waits:
    def __init__(self, clock):
        self.clock, self.waited = clock, []

    def wait(self, timeout_s):
        self.waited.append(timeout_s)
        self.clock.now_s += timeout_s


class Clock:
    now_s = 100.0

    def monotonic(self):
        return self.now_s


def paced(monkeypatch, pace, times, costs=0.0):
    clock = Clock()
    monkeypatch.setattr(feeding, "time", clock)
    waits, pacing = Waits(clock), Pacing(pace)
    for time_s in times:
        pacing.wait(time_s, waits)
        clock.now_s += costs
    return waits.waited, clock.now_s - 100.0


@pytest.mark.parametrize(("pace", "takes_s"), [(1.0, 2.0), (4.0, 0.5)])
def test_a_recording_takes_as_long_as_it_took(monkeypatch, pace, takes_s):
    _, took_s = paced(monkeypatch, pace, [0.5 * step for step in range(5)], costs=0.01)
    assert took_s == pytest.approx(takes_s, abs=0.011)


def test_at_pace_0_nothing_waits(monkeypatch):
    assert paced(monkeypatch, 0.0, [0.0, 1.0, 2.0]) == ([], 0.0)


def test_a_clock_that_began_again_and_a_long_gap_are_not_waited_for(monkeypatch):
    waited, _ = paced(monkeypatch, 1.0, [50.0, 50.5, 1.0, 1.5, math.nan, 1000.0, 1000.5])
    assert sum(waited) == pytest.approx(1.5)

"""All feeds together: each gets every pose with its time, none holds up the poses, and one that fails fails alone."""

import errno
import json
import math
import os
import threading

import pytest

from goldfield.cli.pose_lines import json_record_line
from goldfield.errors import UserError
from goldfield.feeds.address import parse_address
from goldfield.feeds.opening import Feeds, open_feeds
from goldfield.types import Status
from goldfield.view import unix_time
from goldfield.view.truth import NO_ERROR
from tests.host.feeds.made import SITE, UNIX_S, epoch, failed, fix, pose, setting, stamped

CYCLE_S = SITE.cycle_s


class Kept:
    """A feed that keeps what it gets."""

    dropped = 0

    def __init__(self, *, whole=False):
        self.whole = whole
        self.got, self.closed = [], 0
        self.came = threading.Semaphore(0)

    def write(self, stamped_):
        self.got.append(stamped_)
        self.came.release()

    def close(self):
        self.closed += 1


class Held(Kept):
    """A feed that is stuck until it is let go."""

    def __init__(self, **how):
        super().__init__(**how)
        self.reached, self.go = threading.Event(), threading.Event()

    def write(self, stamped_):
        self.reached.set()
        assert self.go.wait(60.0)
        super().write(stamped_)


class Broken(Kept):
    """A feed whose second pose fails."""

    def write(self, stamped_):
        if self.got:
            raise OSError("the far end is on fire")
        super().write(stamped_)


def test_every_feed_gets_every_pose_and_is_closed_once():
    kept = [Kept(), Kept()]
    with Feeds([("a", kept[0]), ("b", kept[1])], CYCLE_S, live=True) as feeds:
        for number in range(20):
            feeds.write(epoch(number))
    for one in kept:
        assert [item.pose.epoch for item in one.got] == list(range(20))
        assert one.closed == 1
    assert feeds.dropped == {}
    assert not feeds.failed


def test_poses_have_the_wall_clocks_time_of_their_measurement():
    """The fastest message tells how the clocks differ: here it came 2 ms after the end of its cycle, others later."""
    kept = Kept()
    delays = [0.020, 0.004, 0.002, 0.050, 0.003]
    with Feeds([("a", kept)], CYCLE_S, live=True) as feeds:
        for number, delay in enumerate(delays):
            feeds.write(epoch(number, arrived_s=UNIX_S + (number + 1) * CYCLE_S + delay))
    late_s = [item.unix_s - (UNIX_S + (item.pose.epoch + 0.5) * CYCLE_S) for item in kept.got]
    assert late_s == pytest.approx([0.020, 0.004, 0.002, 0.002, 0.002], abs=1e-4)


@pytest.mark.parametrize("step_s", [-3600.0, -5.0, -0.02, 0.02, 5.0, 29.0, 3600.0])
def test_a_wall_clock_that_is_set_sets_the_poses_that_follow(monkeypatch, step_s):
    """Poses come 2 ms after their cycle, and one that arrived before the clock was set is handed on after it."""
    at = {"steady": 100.0, "ahead": UNIX_S - 100.0}
    monkeypatch.setattr(unix_time, "steady_s", lambda: at["steady"])
    monkeypatch.setattr(unix_time, "wall_s", lambda: at["steady"] + at["ahead"])
    kept = Kept()
    with Feeds([("a", kept)], CYCLE_S, live=True) as feeds:
        for number in range(20):
            at["steady"] = 100.0 + (number + 1) * CYCLE_S + 0.002
            arrived_s = at["steady"] + at["ahead"]
            if number == 10:
                at["ahead"] += step_s
            feeds.write(epoch(number, arrived_s=arrived_s))
    true_s = [UNIX_S + (number + 0.5) * CYCLE_S + (step_s if number >= 10 else 0.0) for number in range(20)]
    late_s = [item.unix_s - true for item, true in zip(kept.got, true_s, strict=True)]
    assert late_s == pytest.approx([0.002] * 20, abs=5e-4)


def test_a_clock_that_jitters_or_is_looked_at_too_slowly_is_not_set(monkeypatch):
    at = {"steady": 100.0, "held": 0.0, "jitter": 0.0}

    def steady():
        at["steady"] += at["held"]
        return at["steady"]

    monkeypatch.setattr(unix_time, "steady_s", steady)
    monkeypatch.setattr(unix_time, "wall_s", lambda: at["steady"] + at["jitter"] + UNIX_S)
    kept = Kept()
    with Feeds([("a", kept)], CYCLE_S, live=True) as feeds:
        for number, (held, jitter) in enumerate([(0.0, 0.0), (0.0, 0.009), (2.0, 0.0), (0.0, 0.0)]):
            at["held"], at["jitter"] = held, jitter
            feeds.write(epoch(number, arrived_s=UNIX_S + (number + 1) * CYCLE_S))
    assert [item.unix_s for item in kept.got] == pytest.approx(
        [UNIX_S + (n + 0.5) * CYCLE_S for n in range(4)], abs=1e-4
    )


def test_a_cycle_between_poses_at_a_rate_is_no_pose_but_tells_the_time_and_what_was_lost():
    kept = Kept()
    with Feeds([("a", kept)], CYCLE_S, live=True) as feeds:
        feeds.write(epoch(0, arrived_s=UNIX_S + CYCLE_S + 0.002, at_rate=True, lost=3))
        feeds.write(fix(1.5 * CYCLE_S, arrived_s=UNIX_S + 1.5 * CYCLE_S + 0.3))
    (only,) = kept.got
    assert only.line.lost == 3
    assert only.unix_s == pytest.approx(UNIX_S + 1.5 * CYCLE_S + 0.002, abs=1e-4)


def test_a_stuck_feed_loses_the_oldest_poses_and_holds_up_nobody(capsys):
    held, kept = Held(), Kept()
    feeds = Feeds([("stuck", held), ("well", kept)], CYCLE_S, live=True, capacity=5)
    feeds.write(epoch(0))
    assert held.reached.wait(60.0)
    for number in range(1, 11):
        assert kept.came.acquire(timeout=60.0)  # the other feed takes each pose while the first is stuck
        feeds.write(epoch(number))
    assert feeds.dropped == {"stuck": 5}
    held.go.set()
    feeds.close()
    assert [item.pose.epoch for item in held.got] == [0, 6, 7, 8, 9, 10]
    assert [item.pose.epoch for item in kept.got] == list(range(11))
    assert capsys.readouterr().err == "goldfield: stuck: is too slow and misses the oldest poses\n"


def test_what_consumers_of_a_feed_have_missed_counts_too():
    kept = Kept()
    with Feeds([("a", kept)], CYCLE_S, live=True) as feeds:
        feeds.write(epoch(0))
        kept.dropped = 7
    assert feeds.dropped == {"a": 7}


def test_a_file_gets_every_pose_of_a_recording():
    kept = Kept(whole=True)
    with Feeds([("file", kept)], CYCLE_S, live=False, capacity=2) as feeds:
        for number in range(500):
            feeds.write(epoch(number))
    assert [item.pose.epoch for item in kept.got] == list(range(500))
    assert feeds.dropped == {}


def test_what_the_system_says_of_a_feed_is_told_without_its_number(capsys):
    class Piped(Broken):
        def write(self, stamped):
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))

    with Feeds([("tum:-", Piped())], CYCLE_S, live=True) as feeds:
        feeds.write(epoch(0))
    assert capsys.readouterr().err == "goldfield: tum:-: Broken pipe; the run goes on without\n"


def test_a_feed_that_fails_is_told_and_the_others_go_on(capsys):
    broken, kept = Broken(), Kept()
    with Feeds([("broken", broken), ("well", kept)], CYCLE_S, live=True) as feeds:
        for number in range(5):
            feeds.write(epoch(number))
    assert feeds.failed
    assert len(kept.got) == 5
    assert (len(broken.got), broken.closed) == (1, 1)
    assert capsys.readouterr().err == "goldfield: broken: the far end is on fire; the run goes on without\n"


def test_feeds_before_one_that_cannot_be_opened_are_closed_again(tmp_path):
    first, second = (parse_address(f"tum:{tmp_path / name}") for name in ("a.txt", "no/b.txt"))
    with pytest.raises(UserError, match=r"no/b\.txt"):
        open_feeds([first, second], setting(), live=True)
    with open_feeds([first], setting(), live=True):  # else another program would be recording into it
        pass


def test_a_missing_package_is_told_with_what_brings_it(monkeypatch):
    def absent(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name="paho.mqtt")

    monkeypatch.setattr("goldfield.feeds.opening.import_module", absent)
    with pytest.raises(UserError, match=r"^feed=mqtt://h/x: needs the package paho: pip install 'goldfield\[feeds\]'$"):
        open_feeds([parse_address("mqtt://h/x")], setting(), live=True)


@pytest.mark.parametrize("item", [epoch(3, lost=2), fix(0.4), fix(0.4, status=Status.WEAK, reason="two beacons")])
def test_a_line_has_the_keys_of_run_and_its_times(item):
    kept = Kept()
    with Feeds([("a", kept)], CYCLE_S, live=True) as feeds:
        feeds.write(item)
    line = kept.got[0].line
    record = json.loads(kept.got[0].json(UNIX_S))
    assert {key: record.pop(key) for key in ("unix_s", "latency_s")} == {"unix_s": None, "latency_s": None}
    assert json.dumps(record) == json_record_line(truth=False)(line, NO_ERROR)


@pytest.mark.parametrize(
    ("live", "unix_s", "latency_s"), [(True, UNIX_S, 0.125), (False, UNIX_S, None), (True, math.nan, None)]
)
def test_the_latency_is_that_of_a_live_pose_with_a_time(live, unix_s, latency_s):
    record = json.loads(stamped(unix_s=unix_s, live=live).json(UNIX_S + 0.125))
    assert record["latency_s"] == latency_s
    assert record["unix_s"] == (None if math.isnan(unix_s) else unix_s)


@pytest.mark.parametrize("status", Status)
def test_what_may_be_sent_without_its_status(status):
    usable = {Status.OK, Status.UNVERIFIED}
    assert stamped(pose(status=status)).usable == (status in usable)
    assert not stamped(pose(status=status), unix_s=math.nan).usable


def test_a_failed_pose_is_a_line_too():
    record = json.loads(stamped(failed()).json(UNIX_S))
    assert (record["status"], record["position_m"], record["reason"]) == ("failed", None, "no beacon was heard")

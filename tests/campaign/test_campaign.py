"""The campaign judges as it says: what is sound is plain, what is wrong is counted, and the file goes on."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from hil_sim.scenario import load_scenario
from tests.campaign import __main__ as command
from tests.campaign.build import build_of
from tests.campaign.carried import ball
from tests.campaign.kinds import KINDS, NOTHING, pair
from tests.campaign.sensor_kinds import passing
from tests.campaign.stage import FAULT_S, Kind
from tests.campaign.table import shown
from tests.campaign.trial import SOUND_S, Outcome, Trial
from tests.campaign.wire_kinds import LOOK_S, at_random, regular
from tests.command import read_results


def outcome(group: str, name: str, seed: int = 1) -> Outcome:
    return command.tried(group, name, seed, "host")


def test_kinds_have_names_of_their_own():
    assert len({(kind.group, kind.name) for kind in KINDS}) == len(KINDS) >= 60


def test_a_sound_bench_has_nothing_to_say():
    """One sound epoch in a thousand may be taken for a wrong one: none of this seed's is."""
    found = Trial(NOTHING, 1).run()
    assert (found.detected_s, found.wrong, found.false_before, found.error) == (None, 0, 0, "")
    assert found.poses == sum(found.statuses.values()) == found.statuses["ok"]
    assert abs(found.poses - found.expected) <= 1
    assert 0.0 < found.worst_m < 0.05
    assert found.recovered_s == pytest.approx(0.05, abs=0.06)


def test_a_pose_that_is_off_by_more_than_it_promises_is_wrong(monkeypatch):
    """The truth is put a metre away: every pose is then wrong, before the fault, too."""
    place = Trial._place
    monkeypatch.setattr(Trial, "_place", lambda *words: place(*words) + np.array([1.0, 0.0, 0.0]))
    found = Trial(NOTHING, 1).run()
    assert found.poses < found.wrong <= found.poses + 10 * (SOUND_S + 0.3)
    assert found.worst_m == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("group", "name", "by", "soon_s"),
    [
        ("sensor", "axis gain -1", "unknown", 0.3),
        ("beacon", "one dies", "dead", 0.3),
        ("beacon", "coil_open", "board", 0.3),
        ("time", "sensor has no power for 3 s", "silence", 0.36),
        ("serial", "nothing comes", "silence", 0.36),
        ("serial", "the host is killed and started again", "silence", 0.36),
        ("CAN", "the sensor loses the bus", "silence", 0.36),
        ("sync wire", "3 glitches/s of 100 us", "clock", 4.0),
    ],
)
def test_what_breaks_is_told_and_is_over_when_it_is_mended(group, name, by, soon_s):
    found = outcome(group, name)
    assert (found.wrong, found.false_before, found.error) == (0, 0, "")
    assert found.by == by
    assert 0.0 < found.detected_s <= soon_s
    assert found.recovered_s is not None


def test_a_master_that_returns_in_hold_over_makes_no_pose_wrong():
    """Its coil drives by its new time before the others have given up the old one: of this seed a pose was wrong."""
    found = outcome("beacon", "the sync master dies", 10)
    assert (found.wrong, found.false_before, found.error) == (0, 0, "")


def test_a_consumer_that_is_slow_loses_nothing_and_is_told_nothing():
    found = outcome("CAN", "who takes the poses is slow")
    assert (found.detected_s, found.wrong, found.error) == (None, 0, "")
    assert found.poses >= found.expected


def test_what_is_carried_is_where_it_was_carried_to():
    trial = Trial(ball("iron", 0.12, 0.2), 1)
    trial.rig.close()
    scenario = trial.scenario
    assert scenario.metal_at(trial.at_s - 0.01) == scenario.metal_at(trial.until_s + 0.01) == ()
    places = [scenario.metal_at(trial.at_s + after_s)[0].centre_m for after_s in (0.01, 2.05, 3.95)]
    np.testing.assert_allclose([place[1] for place in places], [0.4, 1.05, 0.4 + 1.3 * 3.9 / 4.0], atol=1e-9)
    assert all(np.array_equal(place[[0, 2]], places[0][[0, 2]]) for place in places)


def test_another_master_strikes_the_wire_once_a_period_whatever_the_looks():
    trial = SimpleNamespace(rig=SimpleNamespace(now_s=4.0), random=np.random.default_rng(3))
    between = regular(0.0137)(trial)
    looks = 4.0 + LOOK_S * np.arange(101)
    found = [time_s for begin_s, end_s in pairwise(looks) for time_s in between(begin_s, end_s)]
    assert 4.0 <= found[0] < 4.0137
    assert found[-1] > 6.0 - 0.0137
    np.testing.assert_allclose(np.diff(found), 0.0137, rtol=1e-9)


def test_glitches_at_random_come_as_often_as_they_are_said_to():
    """1,000 expected; the bounds are four standard deviations."""
    between = at_random(50.0)(SimpleNamespace(random=np.random.default_rng(3)))
    found = [time_s - number for number in range(20) for time_s in between(number, number + 1.0)]
    assert abs(len(found) - 1000) < 4 * 1000**0.5
    assert 0.0 <= min(found) < max(found) <= 1.0


def test_the_same_seed_makes_the_same_outcome():
    assert outcome("CAN", "a tenth is lost", 2) == outcome("CAN", "a tenth is lost", 2)


def test_a_magnet_is_nearest_in_the_middle_of_the_fault():
    kind = passing("any", 10.0, 0.3, 1.0)
    trial = Trial(kind, 1)
    trial.rig.close()
    (magnet,) = trial.scenario.magnets
    times = np.linspace(trial.at_s, trial.until_s, 101)
    middle = trial.scenario.motion.poses(times[[50]])[0][0]
    away = np.linalg.norm(
        magnet.position_m + np.outer(times - magnet.start_s, magnet.velocity_m_per_s) - middle, axis=1
    )
    assert away.argmin() == 50
    assert away.min() == pytest.approx(0.3)


def test_a_campaign_goes_on_where_it_was_stopped(tmp_path, monkeypatch, capsys):
    path = tmp_path / "outcomes.jsonl"
    kept = [
        Outcome("none", "nothing", 1, poses=100, expected=100),
        Outcome("none", "nothing", 2, poses=99, expected=99),
    ]
    whole = [json.dumps(asdict(one)) for one in kept]
    path.write_text(whole[0] + "\n" + whole[1][:40])
    monkeypatch.setattr(command, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(
        command, "tried", lambda group, name, seed, boards: Outcome(group, name, seed, poses=7, wrong=1)
    )
    words = ["campaign", "--seeds", "3", "--kind", "nothing", "--results", str(path)]
    monkeypatch.setattr("sys.argv", words)
    assert command.main() == 1  # Some poses were wrong.
    found = {(one.group, one.name, one.seed): one.poses for one in read_results(path, Outcome)}
    assert found[("none", "nothing", 1)] == 100
    assert found[("none", "nothing", 2)] == 7  # Its line was cut off.
    assert {one.build for one in read_results(path, Outcome)} == {"", build_of()}
    assert len(found) == 3 * sum("nothing" in kind.name for kind in KINDS)
    assert "none: nothing" in capsys.readouterr().out


class Here:
    """Runs in this process what is submitted."""

    def __init__(self, processes: int, initializer) -> None:
        assert processes > 0

    def shutdown(self, cancel_futures: bool) -> None:
        assert cancel_futures

    def submit(self, call, *words):
        from concurrent.futures import Future

        future: Future[Outcome] = Future()
        future.set_result(call(*words))
        return future


def test_a_pair_is_all_that_its_two_are():
    """The plan of the second did not happen if the first had one, and its duration and the rest never counted."""
    first = Kind("a", "b", plan=lambda scenario, *_: replace(scenario, name="first"), lasts_s=1.0, by_arrival=True)
    second = Kind("c", "d", plan=lambda scenario, *_: replace(scenario, degree=9), emulated=True, serial=True)
    scenario = load_scenario("prigge8")
    for both in (pair(first, second), pair(second, first)):
        planned = both.plan(scenario, 4.0, 8.0, np.random.default_rng(1))
        assert (planned.name, planned.degree) == ("first", 9)
        assert (both.lasts_s, both.by_arrival, both.emulated, both.serial) == (FAULT_S, True, True, True)
    plain = pair(NOTHING, NOTHING)
    assert (plain.plan, plain.by_arrival, plain.emulated, plain.serial) == (None, False, False, False)


def test_outcomes_know_their_sources_and_the_table_tells_if_they_are_not_of_one_build(tmp_path):
    folder = tmp_path / "firmware/core"
    folder.mkdir(parents=True)
    source = folder / "a.c"
    names = []
    for text in ("int a;", "int b;", "int a;"):
        source.write_text(text)
        build_of.cache_clear()
        names.append(build_of(tmp_path))
    assert names[0] == names[2] != names[1]
    kinds = [Outcome("a", "b", seed, build=build) for seed, build in enumerate([names[0], names[0], names[1], ""])]
    assert shown(kinds[:2]).startswith("kind ")
    told = f"not of one build: 2 trials of {names[0]}, 1 trial of {names[1]}, 1 trial of unknown sources\n"
    assert shown(kinds).startswith(told)


def test_the_table_counts():
    kinds = [
        Outcome("a", "b", 1, poses=90, expected=100, detected_s=0.1, by="dead", wrong=2, recovered_s=0.5),
        Outcome("a", "b", 2, poses=101, expected=100, detected_s=0.3, by="dead", recovered_s=None),
        Outcome("a", "c", 1, poses=100, expected=100, error="ended"),
    ]
    table = shown(kinds).splitlines()
    assert table[1].split() == ["a:", "b", "2", "2", "0.20", "0.30", "dead", "2", "10", "1", "0.50"]
    assert table[2].split() == ["a:", "c", "1", "0", "-", "-", "0", "0", "0", "-"]
    assert table[3] == "2 kinds, 3 trials, 291 poses from the faults on, 2 wrong"
    assert table[4] == "1 ended: ended"

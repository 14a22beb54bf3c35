"""The run of a day says what is wrong: a pose, a lost cycle, a counter, memory that grows; else nothing."""

from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from mmap import mmap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from goldfield.types import Status
from tests.bench.day_faults import (
    AFTER_S,
    ALL_ANEW,
    CALM_S,
    EXPLAINED,
    GAP_S,
    Ledger,
    Struck,
    is_of,
    plan,
    possible,
    takes_power,
)
from tests.bench.day_judge import Judge, Seen
from tests.bench.day_memory import holdings, objects, resident_bytes, slope
from tests.bench.day_run import GROWTH_BYTES_PER_H, OBJECTS_PER_H, Day, Hour
from tests.campaign.kinds import KINDS
from tests.campaign.links import silent, sound
from tests.campaign.stage import CYCLE_S, Kind
from tests.campaign.trial import LATE_CYCLES, TRANSFER_S

MINUTE_H = 1.0 / 60.0
LEAD_CYCLES = 100
"""Cycles of the wire that are over when the host begins to take poses."""


@pytest.fixture(scope="module")
def minute() -> Iterator[tuple[Day, list[str]]]:
    day = Day(MINUTE_H, 1)
    yield day, day.run()
    day.rig.close()


def struck(day: Day) -> list[str]:
    """Run a day, and return what is wrong."""
    try:
        return day.run()
    finally:
        day.rig.close()


# ---- A run ----


def test_a_sound_minute_has_nothing_wrong(minute: tuple[Day, list[str]]) -> None:
    day, found = minute
    assert found == []
    assert day.judge.lost.total() == 0
    assert 0 <= day.judge.cycles - day.judge.poses.total() <= LEAD_CYCLES
    assert 0.0 < day.judge.worst_m < 0.06


def test_its_number_of_the_cycle_wraps_once_and_what_takes_longer_does_not(minute: tuple[Day, list[str]]) -> None:
    wraps = minute[0].wraps()
    assert wraps["number of the cycle, 20 bits"] == 1
    assert wraps["ticks of a board, 32 bits of 168 MHz"] == int(minute[0].running_s.max() * 168e6 // 2**32) == 2
    assert wraps["microseconds of the sensor, 32 bits"] == 0


def test_the_same_seed_makes_the_same_day(minute: tuple[Day, list[str]]) -> None:
    again = Day(MINUTE_H, 1)
    assert struck(again) == []
    assert (again.judge.poses, again.judge.worst_m) == (minute[0].judge.poses, minute[0].judge.worst_m)


def test_a_wrong_pose_is_found() -> None:
    """The truth is put a metre away."""
    day = Day(0.5 * MINUTE_H, 1)
    poses = day.judge.motion.poses

    class Beside:
        still = False

        def poses(self, times_s: np.ndarray) -> tuple[np.ndarray, object]:
            places, turns = poses(times_s)
            return places + np.array([1.0, 0.0, 0.0]), turns

    day.judge.motion = Beside()
    found = struck(day)
    assert len([one for one in found if "off by" in one]) == day.judge.poses["ok"] > 100


def test_a_counter_and_cycles_that_no_fault_explains_are_found() -> None:
    day = Day(0.5 * MINUTE_H, 1)
    day.at(15.0, lambda stage: stage.rig.can_write(0x1FFFFFFF, bytes(8)))
    day.at(20.0, lambda stage: setattr(stage.link, "spoil", silent))
    day.at(21.0, lambda stage: setattr(stage.link, "spoil", sound))
    found = struck(day)
    boards = [1, 4, 6, 7, 8, 100]
    assert [one for one in found if "foreign" in one] == [
        f"node {node} counts 1 foreign frames behind no fault" for node in boards
    ]
    assert any("cycles lost behind no fault" in one for one in found)
    assert day.judge.lost[""] in (9, 10, 11)


def test_a_drive_that_five_trips_in_a_row_lock_out_gets_its_power_anew() -> None:
    """Nothing else brings it back: in the first whole day a beacon was gone for a quarter of an hour."""
    day = Day(1.6 * MINUTE_H, 1)
    opened = Kind(
        "beacon",
        "coil_open",
        lambda stage: stage.rig.fault(2, "coil_open"),
        lambda stage: (stage.rig.fault(2, "coil_open", active=False), stage.clear(2)),
    )
    for begin_s in (12.0, 16.0, 21.0, 28.0, 39.0):  # Behind the n-th trip a drive waits for 2^(n-1) s.
        day._await(Struck(opened, begin_s, begin_s + 2.0))
    assert struck(day) == []
    assert day.restarted == [day.scenario.beacons[1].node]
    assert sum(day.judge.not_plain.values()) == 0
    assert day.judge.sound > 200


class Along:
    """A motion of a metre a second along x."""

    def poses(self, times_s):  # type: ignore[no-untyped-def]
        return np.stack([times_s, 0.0 * times_s, 0.0 * times_s], axis=1), None


def test_cycles_that_come_late_behind_a_cut_are_held_to_where_the_sensor_was() -> None:
    """What a board has kept comes first, and tells nothing here; then what is new: no cycle comes before it was."""
    judge = Judge(Along())  # type: ignore[arg-type]
    kind = next(kind for kind in possible() if kind.name == "the sensor loses the bus")
    seen = []
    for number, late in ((45, 0), (46, 40), (85, 2), (86, 1), (87, 0), (88, 0)):
        status = Status.FAILED if late > LATE_CYCLES else Status.OK
        place_m = np.array([number * CYCLE_S, 0.0, 0.0])
        pose = SimpleNamespace(epoch=number, status=status, position_m=place_m, protection_m=0.05)
        came_s = (number + late + 0.5) * CYCLE_S + TRANSFER_S
        epoch = SimpleNamespace(pose=pose)
        seen.append(Seen(came_s, came_s, epoch, Struck(kind, 4.0, 8.0)))  # type: ignore[arg-type]
    judge.judge(seen, [(number, number * CYCLE_S, CYCLE_S) for number in range(100)])
    assert judge.poses == {"ok": 5, "failed": 1}
    assert judge.wrong == []


def test_a_table_is_written(tmp_path: Path) -> None:
    path = tmp_path / "day.txt"
    day = Day(0.2 * MINUTE_H, 1)
    with path.open("w") as out:
        assert day.run(out) == []
    day.rig.close()
    assert "off by more than promised: 0" in path.read_text()


# ---- Memory ----


@pytest.mark.parametrize(
    ("name", "most"), [("resident", GROWTH_BYTES_PER_H), ("objects", OBJECTS_PER_H), ("held", OBJECTS_PER_H)]
)
def test_what_grows_faster_than_its_bound_is_a_leak(
    minute: tuple[Day, list[str]], monkeypatch: pytest.MonkeyPatch, name: str, most: float
) -> None:
    def grown(per_hour: float) -> list[str]:
        early = Hour(1.0, 1, 10**6, 10**6)  # The first hours do not count.
        late = [Hour(float(n), *(round(per_hour * n) if part == name else 7 for part in PARTS)) for n in range(4, 25)]
        monkeypatch.setattr(minute[0], "hours", [early, *late])
        return minute[0].wrong()

    assert grown(most - 1.0) == grown(-10 * most) == []
    (found,) = grown(most + 1.0)
    assert found.startswith(f"{name} grows by {most + 1:.0f} an hour")


PARTS = ("resident", "objects", "held")


def test_what_is_held_and_what_is_resident_is_counted() -> None:
    class Host:
        def __init__(self) -> None:
            self.queue: list[object] = []
            self.bench = {"kept": list(range(1000))}
            self.locate = self.located([])

        def located(self, history: list[int]) -> Callable[[int], None]:
            return lambda one: history.append(one)

    host = Host()
    held = holdings(host, host.bench).total()
    host.queue += [{"a": (number, number)} for number in range(50)]
    assert holdings(host, host.bench).total() - held == 50 + 50 * (1 + 2)
    host.locate(1)
    assert holdings(host, host.bench).total() - held == 201
    known, before = objects(), resident_bytes()  # In this order: the first collects what others have left.
    kept = [mmap(-1, 10**8), *([] for _ in range(1000))]  # It never comes out of what was freed before.
    kept[0].write(bytes(10**8))
    assert resident_bytes() - before > 9e7
    assert 1000 <= objects() - known < 1100
    assert len(kept) == 1001


def test_slope_is_that_of_a_line() -> None:
    assert slope([4.0, 5.0, 6.0], [1.0, 3.0, 5.0]) == pytest.approx(2.0)
    assert slope([4.0], [1.0]) == 0.0


# ---- Faults and counters ----


def test_a_day_of_faults_has_every_kind_and_leaves_boards_in_calm_spells() -> None:
    day = plan(9.0, 86400.0, 1860.0, np.random.default_rng(1))
    seen = Counter(one.kind.name for one in day)
    assert 300 < len(day) < 600
    assert set(seen) == {kind.name for kind in possible()}
    assert max(seen.values()) - min(seen.values()) <= 5
    assert all(GAP_S[0] <= b.begin_s - a.until_s <= GAP_S[1] for a, b in pairwise(day))
    assert day[-1].until_s + AFTER_S < 86409.0
    assert not any(is_of(one.kind, ALL_ANEW) for one in day if one.begin_s < 1860.0)
    assert not any(takes_power(one.kind) for one in day if one.begin_s % (2 * CALM_S) >= CALM_S)
    assert any(is_of(one.kind, ALL_ANEW) for one in day)


def test_what_a_fault_explains_begins_with_it_and_ends_behind_it() -> None:
    one = Struck(possible()[0], 100.0, 104.0)
    assert one.explains(90.0, 100.0)
    assert not one.explains(90.0, 99.9)
    assert one.explains(104.0 + AFTER_S, 200.0)
    assert not one.explains(104.1 + AFTER_S, 200.0)


def test_what_explains_a_counter_are_kinds_that_there_are() -> None:
    names = {part for kind in KINDS for part in kind.name.split(" + ")}
    for counter, kinds in EXPLAINED.items():
        for kind in kinds:
            assert any(name.startswith(kind) for name in names), (counter, kind)
    assert Ledger().unexplained() == []

"""The bench measures rightly: pairs against a clock of the test's own, history as JSON, comparison, and the page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.bench.peers import history, page
from tests.bench.peers.__main__ import SUBJECTS, main
from tests.bench.peers.bench import Bench
from tests.bench.peers.history import REFERENCE, Run, append, compared, newest, read
from tests.bench.peers.measure import LEAST_S, added_bytes, paired
from tests.bench.peers.row import Goal, Row
from tests.bench.peers.table import cells, differences, markdown, number, text


class Machine:
    """A machine whose time goes on by what its tasks take, times how loaded it is."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.calls: list[str] = []
        self.loads: Iterator[float] | None = None

    def clock(self) -> float:
        return self.now_s

    def task(self, name: str, seconds: float):
        def run() -> None:
            self.calls.append(name)
            self.now_s += seconds * (1.0 if self.loads is None else next(self.loads))

        return run


ROW = Row("decode", "messages", "messages/s", 2e5, "cantools 45.1.0", 1e5, 2.0, (1.9, 2.2), 1.5, 3.0)
RUN = Run("0123456789", "2026-11-29", "a processor", 2, 0.3, (ROW,))


def test_pairs_are_taken_in_turns_and_each_way_is_first_in_turn() -> None:
    machine = Machine()
    timing = paired(machine.task("a", 1.0), machine.task("b", 3.0), rounds=3, clock=machine.clock)
    assert "".join(machine.calls) == "ab" + "ab" + "ba" + "ab"  # A call of each beforehand.
    assert (timing.ours_s, timing.theirs_s, timing.ratio) == (1.0, 3.0, 3.0)
    assert (timing.least_ratio, timing.most_ratio) == (3.0, 3.0)


def test_a_load_that_comes_and_goes_strikes_both_and_leaves_the_ratio() -> None:
    machine = Machine()
    machine.loads = iter([1.0, 1.0, *(load for load in (1, 5, 2, 9, 1) for _ in "ab")])
    timing = paired(machine.task("a", 1.0), machine.task("b", 3.0), rounds=5, clock=machine.clock)
    assert timing.ratio == pytest.approx(3.0)
    assert (timing.ours_s, timing.theirs_s) == pytest.approx((2.0, 6.0))


def test_one_disturbed_call_moves_neither_medians_nor_ratio() -> None:
    machine = Machine()
    machine.loads = iter([1.0, 1.0, *[1.0] * 4, 100.0, *[1.0] * 5])
    timing = paired(machine.task("a", 1.0), machine.task("b", 3.0), rounds=5, clock=machine.clock)
    assert (timing.ours_s, timing.theirs_s, timing.ratio) == (1.0, 3.0, 3.0)


def test_what_is_short_is_repeated_until_the_clock_can_tell() -> None:
    machine = Machine()
    timing = paired(machine.task("a", LEAST_S / 7.5), machine.task("b", 0.3), rounds=2, clock=machine.clock)
    assert machine.calls.count("a") == 2 + 2 * 8
    assert machine.calls.count("b") == 2 + 2
    assert timing.ours_s == pytest.approx(LEAST_S / 7.5)


def test_figures_are_of_one_piece_of_work_and_ratios_of_the_same_work() -> None:
    machine = Machine()
    bench = Bench(rounds=3, clock=machine.clock, memory=False)
    ours, theirs = machine.task("a", 2.0), machine.task("b", 4.0)
    row = bench.pair("x", "y", ours, "peer", theirs, work=1000, their_work=10, goal=Goal("ratio", at_least=200.0))
    assert (row.ours, row.theirs, row.ratio) == pytest.approx((2e3, 4e5, 200.0))
    assert row.quartiles == pytest.approx((200.0, 200.0))
    rates = bench.pair("x", "y", ours, "peer", theirs, unit="poses/s", work=100)
    assert (rates.ours, rates.theirs, rates.ratio) == pytest.approx((50.0, 25.0, 2.0))


def test_memory_is_what_a_task_adds_at_its_peak() -> None:
    def allocates() -> float:
        return float(np.ones(5_000_000).sum())

    added = added_bytes(allocates)
    assert added is not None
    assert 40e6 < added < 48e6
    assert (added_bytes(lambda: None) or 0) < 2e6


@pytest.mark.parametrize(
    ("goal", "ours", "ratio", "met"),
    [
        (Goal("ratio", at_least=100.0), 1.0, 100.0, True),
        (Goal("ratio", at_least=100.0), 1000.0, 99.9, False),
        (Goal("ours", at_most=5.0), 5.0, 100.0, True),
        (Goal("ours", at_most=5.0), 5.1, 0.0, False),
        (Goal("ratio", at_least=100.0), 1000.0, None, False),
        (None, 1.0, 1.0, None),
    ],
)
def test_a_goal_is_met_or_not(goal: Goal | None, ours: float, ratio: float | None, met: bool | None) -> None:
    row = replace(ROW, ours=ours, ratio=ratio, goal=goal)
    assert row.met is met
    assert ("NOT MET" in text([row])) is (met is False)


def test_a_run_comes_back_from_its_line_as_it_was() -> None:
    bare = Row("rig", "9 boards", "virtual s/s", 1.5)
    run = replace(RUN, rows=(ROW, bare, replace(ROW, goal=Goal("ours", at_least=1e5))))
    assert Run.from_line(run.as_line()) == run
    assert "\n" not in run.as_line()


def test_runs_are_kept_in_their_order_and_a_line_that_was_cut_off_spoils_no_other(tmp_path) -> None:
    path = tmp_path / "folder/history.jsonl"
    assert read(path) == []
    later = replace(RUN, date="2026-11-30")
    append(path, RUN)
    with path.open("a") as file:
        file.write(later.as_line()[:50])
    append(path, later)
    assert read(path) == [RUN, later]


def test_rows_are_compared_by_ratio_or_by_figure_whichever_way_is_better() -> None:
    def changed(**values: object) -> float:
        ((_, _, better),) = compared(
            replace(RUN, rows=(bare,)),
            replace(RUN, rows=(replace(bare, **values),)),  # type: ignore[arg-type]
        )
        return better

    bare = ROW
    assert changed(ratio=4.0, ours=1e5, peer="cantools 46.0") == pytest.approx(2.0)  # A slower machine, a newer peer.
    bare = Row("rig", "9 boards", "virtual s/s", 1.5)
    assert changed(ours=3.0) == pytest.approx(2.0)
    bare = Row("latency", "pose", "ms", 1.5)
    assert changed(ours=3.0) == pytest.approx(0.5)
    assert compared(RUN, replace(RUN, rows=(replace(ROW, what="others"),))) == []


def test_what_became_worse_is_told_and_what_is_within_the_scatter_is_not() -> None:
    def against(ratio: float) -> str:
        return differences(RUN, replace(RUN, commit="abc", rows=(replace(ROW, ratio=ratio),)))

    assert against(2.0 / 1.16).splitlines()[1:] == [
        "WORSE: decode, messages beside cantools 45.1.0: 2.00 -> 1.72 times"
    ]
    assert "better" in against(2.0 * 1.16)
    assert against(2.0 / 1.14).splitlines() == [
        "1 rows of 2026-11-29 (0123456789) and 2026-11-29 (abc): 0 differ by more than 1.15 times"
    ]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, ""),
        (0.0, "0"),
        (0.00806, "0.00806"),
        (1.234, "1.23"),
        (99.4, "99.4"),
        (999.6, "1,000"),
        (15745013.4, "15,745,013"),
    ],
)
def test_numbers_show_three_digits_that_count(value: float | None, shown: str) -> None:
    assert number(value) == shown


def test_a_run_of_several_calls_has_the_last_of_each_subject_and_tells_its_commits() -> None:
    location = replace(ROW, subject="location")
    older = replace(RUN, commit="abc", rows=(location, replace(ROW, ratio=9.0)), load=7.0)
    replaced = replace(RUN, commit="def", rows=(location,), load=9.0)
    other = replace(RUN, date="2026-11-28", rows=(replace(ROW, subject="plan"),))
    found = newest([other, replaced, older, RUN], ["decode", "plan", "location"])
    assert found == replace(RUN, commit="abc 0123456789", rows=(ROW, location), load=7.0)


def test_the_page_has_the_table_of_the_last_run_that_is_kept() -> None:
    runs = read(REFERENCE)
    assert runs
    shown = page.PAGE.read_text(encoding="utf-8")
    assert page.written(shown, runs[-1]) == shown, "run `python -m tests.bench.peers --keep`, or restore the page"
    assert {row.subject for row in runs[-1].rows} <= set(SUBJECTS)


def test_a_page_without_the_part_is_told_and_with_it_keeps_the_rest() -> None:
    with pytest.raises(ValueError, match="no part between"):
        page.written("text", RUN)
    text_ = f"before\n{page.BEGIN}what was\n{page.END}after\n"
    found = page.written(text_, RUN)
    assert found.startswith("before\n")
    assert found.endswith(f"{page.END}after\n")
    assert markdown(RUN.rows) in found
    assert "what was" not in found


def test_a_missed_goal_ends_with_1_and_the_run_is_written(tmp_path, monkeypatch, capsys) -> None:
    missed = replace(ROW, goal=Goal("ratio", at_least=3.0))
    monkeypatch.setattr(history, "HISTORY", tmp_path / "history.jsonl")
    for row, status in ((ROW, 0), (missed, 1)):
        monkeypatch.setattr("tests.bench.peers.decode.rows", lambda bench, row=row: [row])
        assert main(["decode", "--rounds", "1"]) == status
    assert [run.rows for run in read(tmp_path / "history.jsonl")] == [(ROW,), (missed,)]
    assert cells(missed)[-1] in capsys.readouterr().out
    assert main(["--compare"]) == 0
    assert "1 rows of" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["coffee"])

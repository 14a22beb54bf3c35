"""Sinks fed by threads of their own: in order, without holding up each other, and what happens when one fails."""

import contextlib
import threading
from types import SimpleNamespace

import pytest

from goldfield.cli.live import end_recording
from goldfield.sensor.sinks import Branch, Fanout, Part
from tests.host.interrupted import interrupted_after


class Kept:
    """Keeps what it gets."""

    def __init__(self):
        self.items, self.closed = [], 0

    def write(self, item):
        assert not self.closed
        self.items.append(item)

    def close(self):
        self.closed += 1


class Held(Kept):
    """Says that it got an item, then blocks until it is let go."""

    def __init__(self):
        super().__init__()
        self.reached, self.go = threading.Event(), threading.Event()

    def write(self, item):
        self.reached.set()
        assert self.go.wait(60.0)
        super().write(item)


class Broken(Kept):
    """Raises at the third item."""

    def __init__(self, error):
        super().__init__()
        self.error = error

    def write(self, item):
        if len(self.items) == 2:
            raise self.error
        super().write(item)


def write_all(fanout, count):
    for item in range(count):
        fanout.write(item)


def test_every_sink_gets_every_item_in_order_and_is_closed_once():
    sinks = [Kept(), Kept()]
    with Fanout(waits=True) as fanout:
        for sink in sinks:
            fanout.add(sink, "kept", capacity=2)
        for item in range(500):
            fanout.write(item)
    fanout.close()
    assert [sink.items for sink in sinks] == [list(range(500))] * 2
    assert [sink.closed for sink in sinks] == [1, 1]
    assert fanout.dropped == {}


def test_a_part_of_every_item():
    kept = Kept()
    with Fanout(waits=True) as fanout:
        fanout.add(Part(kept, len), "kept")
        fanout.write("four")
    assert (kept.items, kept.closed) == ([4], 1)


def test_a_slow_sink_of_a_live_source_drops_whole_items_and_holds_up_nobody():
    held, kept = Held(), Kept()
    with Fanout(waits=False) as fanout:
        fanout.add(held, "the slow one", capacity=3)
        fanout.add(kept, "the quick one")
        fanout.write(0)
        assert held.reached.wait(60.0)  # item 0 is in its hands, its queue is empty
        for item in range(1, 10):
            fanout.write(item)
        held.go.set()
    assert held.items == [0, 1, 2, 3]
    assert kept.items == list(range(10))
    assert fanout.dropped == {"the slow one": 6}


def test_a_recording_waits_for_a_slow_sink():
    held = Held()
    branch = Branch(held, "slow", waits=True, capacity=1)
    branch.write(0)
    assert held.reached.wait(60.0)
    branch.write(1)  # fills the queue
    writer = threading.Thread(target=branch.write, args=(2,))
    writer.start()
    assert writer.is_alive()
    held.go.set()
    writer.join(60.0)
    branch.close()
    assert (held.items, branch.dropped) == ([0, 1, 2], 0)


@pytest.mark.parametrize(
    ("error", "words"), [(OSError(28, "No space left on device"), "No space left"), (KeyError(), "KeyError")]
)
def test_a_sink_that_fails_is_told_once_and_the_others_go_on(capsys, error, words):
    broken, kept = Broken(error), Kept()
    with Fanout(waits=True) as fanout:
        fanout.add(broken, "map.csv", capacity=1)
        fanout.add(kept, "kept", capacity=1)
        for item in range(20):
            fanout.write(item)
    assert (broken.items, broken.closed) == ([0, 1], 1)
    assert kept.items == list(range(20))
    err = capsys.readouterr().err
    assert err.startswith("goldfield: map.csv: ")
    assert err.endswith("; the run goes on without\n")
    assert words in err
    assert err.count("\n") == 1


def test_an_essential_sink_that_fails_ends_the_run(capsys):
    broken, kept = Broken(BrokenPipeError()), Kept()
    fanout = Fanout(waits=True)
    fanout.add(broken, "stdout", essential=True, capacity=1)
    fanout.add(kept, "kept")
    with pytest.raises(BrokenPipeError):
        write_all(fanout, 20)
    fanout.close()
    assert len(kept.items) <= 5  # with room for one item the writer learns of it at the sixth at the latest
    assert (broken.closed, kept.closed) == (1, 1)
    assert capsys.readouterr().err == ""


def test_an_error_at_the_last_item_is_raised_by_close():
    broken = Broken(ValueError("bad"))
    fanout = Fanout(waits=True)
    fanout.add(broken, "stdout", essential=True)
    write_all(fanout, 3)
    with pytest.raises(ValueError, match="bad"):
        fanout.close()
    assert broken.closed == 1


def interrupted(sinks):
    with sinks:
        write_all(sinks, 4)
        raise KeyboardInterrupt


@pytest.mark.parametrize("waits", [False, True])
def test_an_interrupt_is_not_held_up_by_a_stuck_sink(monkeypatch, waits):
    monkeypatch.setattr("goldfield.sensor.sinks.INTERRUPTED_S", 0.0)
    held = Held()
    sinks = Fanout(waits=waits)
    sinks.add(held, "held")
    assert not sinks.stuck
    with pytest.raises(KeyboardInterrupt):
        interrupted(sinks)
    assert held.reached.wait(60.0)
    assert sinks.stuck
    assert sinks.dropped == {"held": 3}
    held.go.set()
    sinks.close()
    assert not sinks.stuck
    assert (held.items, sinks.dropped) == ([0, 1, 2, 3], {})


def test_a_failing_sink_holds_nothing_up_where_nobody_can_be_told(monkeypatch):
    def full(text):
        raise OSError("no space left")

    monkeypatch.setattr("sys.stderr", SimpleNamespace(write=full, flush=lambda: None))
    with Fanout(waits=True) as fanout:
        fanout.add(Broken(ValueError("broken")), "broken", capacity=2)
        write_all(fanout, 50)


def test_a_recording_with_gaps_is_told(capsys):
    held = Held()
    recorder = Branch(held, "a.log", waits=False, capacity=1)
    recorder.write(0)
    assert held.reached.wait(60.0)
    for message in (1, 2, 3):
        recorder.write(message)
    held.go.set()
    end_recording(recorder)
    assert capsys.readouterr().err == "goldfield: a.log: 2 messages are missing in it, because the disk was too slow\n"


def test_a_slow_sink_may_lose_the_oldest_items():
    held = Held()
    branch = Branch(held, "held", waits=False, capacity=3, newest=True)
    branch.write(0)
    assert held.reached.wait(60.0)
    for item in range(1, 8):
        branch.write(item)
    assert branch.dropped == 4
    held.go.set()
    branch.close()
    assert held.items == [0, 5, 6, 7]


@pytest.mark.parametrize("lines", range(6))
def test_an_interrupt_at_any_line_of_closing_leaves_no_sink_without_its_end(lines):
    kept = Kept()
    branch = Branch(kept, "kept", waits=True)
    with interrupted_after(lines, Branch.close), contextlib.suppress(KeyboardInterrupt):
        branch.close()
    branch.close(60.0)
    assert not branch.stuck


@pytest.mark.parametrize("lines", range(6))
def test_an_interrupt_at_any_line_of_closing_changes_no_count(lines):
    held = Held()
    branch = Branch(held, "held", waits=True)
    for item in range(4):
        branch.write(item)
    assert held.reached.wait(60.0)
    with interrupted_after(lines, Branch.close), contextlib.suppress(KeyboardInterrupt):
        branch.close(0.0)
    branch.close(0.0)
    assert branch.stuck
    assert branch.dropped == 3
    held.go.set()
    branch.close(60.0)
    assert (held.items, branch.dropped) == ([0, 1, 2, 3], 0)


@pytest.mark.parametrize("lines", range(20))
def test_sinks_that_an_interrupt_leaves_open_are_closed_again(lines):
    kept = [Kept(), Kept()]
    sinks = Fanout(waits=True)
    for one in kept:
        sinks.add(one, "kept")
    functions = (Fanout.__exit__, Fanout.close, Fanout._close, Branch.close)
    with interrupted_after(lines, *functions), contextlib.suppress(KeyboardInterrupt), sinks:
        sinks.write(1)
    sinks.close_again()
    sinks.close(60.0)
    assert [(one.items, one.closed) for one in kept] == [([1], 1)] * 2

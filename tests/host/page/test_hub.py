"""The hub: what a browser gets first, what a slow one loses, how the stream's state is told, and that nothing grows."""

import json
import tracemalloc

from goldfield.page.hub import CAPACITY, HISTORY, SILENCE_S, Hub, State


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


def hub_of(*, live=True, cycle_s=0.1):
    clock = Clock()
    return Hub("hello", cycle_s, live=live, clock=clock), clock


def state_of(hub):
    return json.loads(hub.state_message())


def test_a_browser_gets_the_site_the_latest_epochs_and_the_latest_health_first():
    hub, _ = hub_of()
    for number in range(HISTORY + 5):
        hub.publish_epoch(f"epoch {number}")
    for number in range(3):
        hub.publish_health(f"health {number}")
    box = hub.open()
    assert box.take() == ["hello", *(f"epoch {n}" for n in range(5, HISTORY + 5)), "health 2"]
    hub.publish_epoch("next")
    assert box.take() == ["next"]
    assert box.take() == []


def test_a_browser_that_takes_nothing_loses_the_oldest_and_is_told_how_many():
    hub, _ = hub_of()
    slow, quick = hub.open(), hub.open()
    assert slow.take() == quick.take() == ["hello"]
    got = []
    for number in range(CAPACITY):
        hub.publish_fix(str(number))
        got += quick.take()
    assert len(slow.take()) == CAPACITY  # just what there is room for
    for number in range(CAPACITY + 7):
        hub.publish_fix(str(number))
        got += quick.take()
    told, *rest = slow.take()
    assert json.loads(told) == {"type": "dropped", "count": 7}
    assert rest == [str(number) for number in range(7, CAPACITY + 7)]
    assert len(got) == 2 * CAPACITY + 7
    assert slow.take() == []


def test_the_end_is_the_last_that_every_browser_gets():
    hub, _ = hub_of()
    box = hub.open()
    hub.publish_epoch("last")
    hub.end("the port is gone")
    assert not hub.drained
    *_, epoch, end = box.take()
    assert epoch == "last"
    assert json.loads(end) == {"type": "state", "state": "ended", "text": "the port is gone", "silent_s": 0.0}
    assert hub.drained
    assert state_of(hub)["state"] == "ended"


def test_a_browser_that_is_gone_gets_nothing_more():
    hub, _ = hub_of()
    box = hub.open()
    hub.close(box)
    hub.publish_fix("late")
    assert box.take() == ["hello"]
    assert hub.browsers == 0


def test_a_live_stream_that_stops_is_told_and_so_is_its_return():
    hub, clock = hub_of()
    assert state_of(hub)["state"] == "waiting"
    hub.publish_epoch("first")
    clock.now_s = SILENCE_S
    assert state_of(hub) == {"type": "state", "state": "running", "text": "", "silent_s": SILENCE_S}
    clock.now_s = SILENCE_S + 0.1
    assert state_of(hub)["state"] == "silent"
    assert "cable" in state_of(hub)["text"]
    hub.publish_epoch("second")
    assert state_of(hub)["state"] == "running"
    hub.set_state(State.LOST, "the port is gone")
    assert (state_of(hub)["state"], state_of(hub)["text"]) == ("lost", "the port is gone")
    hub.publish_epoch("third")
    assert state_of(hub) == {"type": "state", "state": "running", "text": "", "silent_s": 0.0}


def test_a_link_that_is_waited_for_is_lost_at_once_and_only_as_long_as_it_is_gone():
    hub, clock = hub_of()
    hub.publish_epoch("first")
    gone = ""
    hub.watch(lambda: gone)
    assert state_of(hub)["state"] == "running"
    gone = "the cable was pulled; waiting for it"
    assert (state_of(hub)["state"], state_of(hub)["text"]) == ("lost", gone)
    clock.now_s, gone = 2.0 * SILENCE_S, ""
    assert state_of(hub)["state"] == "silent"
    hub.publish_epoch("second")
    assert state_of(hub)["state"] == "running"
    gone = "the cable was pulled"
    hub.end("goldfield has ended")
    assert state_of(hub)["state"] == "ended"


def test_long_cycles_are_waited_for_and_a_recording_is_never_silent():
    hub, clock = hub_of(cycle_s=1.0)
    hub.publish_epoch("first")
    clock.now_s = 5.0
    assert state_of(hub)["state"] == "running"
    clock.now_s = 5.1
    assert state_of(hub)["state"] == "silent"
    recording, clock = hub_of(live=False)
    recording.publish_epoch("first")
    clock.now_s = 1e6
    assert state_of(recording)["state"] == "running"


def test_ten_thousand_epochs_take_no_more_memory_than_the_first_thousand():
    hub, _ = hub_of()
    sleeping = hub.open()

    def publish(first, last):
        for number in range(first, last):
            hub.publish_epoch(f"{number:<2000}")

    tracemalloc.start()
    try:
        publish(0, 1000)
        before, _ = tracemalloc.get_traced_memory()
        publish(1000, 10_000)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert before > CAPACITY * 2000
    assert after - before < 20_000  # ten epochs, of nine thousand
    assert len(sleeping.take()) == CAPACITY + 2

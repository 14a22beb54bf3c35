"""The message queue against a deque."""

from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st


def make(core, capacity, first=0):
    ffi, lib = core
    storage = ffi.new("frame_t[]", max(capacity, 1))
    queue = ffi.new("queue_t *")
    assert lib.queue_init(queue, storage, capacity)
    queue.head = queue.tail = first
    return queue, storage


@given(
    capacity=st.sampled_from([1, 2, 8]),
    first=st.sampled_from([0, 2**31 - 2, 2**32 - 3]),
    operations=st.lists(st.sampled_from(["push", "push", "front", "drop"]), max_size=60),
)
def test_behaves_as_a_bounded_deque(core, capacity, first, operations):
    ffi, lib = core
    queue, storage = make(core, capacity, first)
    model, lost, number = deque(), 0, 0
    for operation in operations:
        if operation == "push":
            number += 1
            message = ffi.new("frame_t *", {"id": number, "length": number % 9, "data": [number % 256] * 8})
            fits = len(model) < capacity
            assert lib.queue_push(queue, message) == fits
            if fits:
                model.append(number)
            else:
                lost += 1
        elif operation == "drop":
            lib.queue_drop(queue)
            if model:
                model.popleft()
        front = lib.queue_front(queue)
        if model:
            assert (front.id, front.length, front.data[7]) == (model[0], model[0] % 9, model[0] % 256)
        else:
            assert front == ffi.NULL
        assert lib.queue_count(queue) == len(model)
        assert queue.lost == lost
    assert storage is not None


def test_loss_counter_stops(core):
    ffi, lib = core
    queue, _storage = make(core, 1)
    queue.lost = 2**32 - 2
    for _ in range(4):
        lib.queue_push(queue, ffi.new("frame_t *"))
    assert queue.lost == 2**32 - 1


@pytest.mark.parametrize("capacity", [0, 3, 12, 2**32 - 1])
def test_capacity_is_a_power_of_two(core, capacity):
    ffi, lib = core
    assert not lib.queue_init(ffi.new("queue_t *"), ffi.NULL, capacity)

"""The machine without a processor: order of events, and what a bus master reaches."""

import random
from collections.abc import Iterator
from typing import Any

import pytest

from hil_sim import clib
from hil_sim.emulator.emulator import LIBRARY


class Machine:
    def __init__(self) -> None:
        self.ffi: Any
        self.library: Any
        self.ffi, self.library = clib.load(LIBRARY, ["emulator/machine_bench.h"])
        self.config = self.ffi.new("emulator_config_t *")
        self.pointer = self.library.machine_bench_create(self.config, self.ffi.NULL)
        self.fired: list[tuple[int, int, int]] = []
        self.callback = self.ffi.callback("void(void *, int64_t)", self.fire)
        self.events: list[Any] = []

    def fire(self, context: Any, time_ps: int) -> None:
        index = int(self.ffi.cast("uintptr_t", context))
        self.fired.append((time_ps, index, self.library.machine_now(self.pointer)))

    def event(self) -> Any:
        event = self.ffi.new("machine_event_t *")
        self.library.machine_event_init(event, self.callback, self.ffi.cast("void *", len(self.events)))
        self.events.append(event)
        return event

    def run(self, until_ps: int) -> None:
        self.library.machine_bench_operations.run(self.ffi.cast("board_t *", self.pointer), until_ps)

    def bus(self, address: int, value: int | None = None, width: int = 4) -> int | None:
        """Read (no value) or write as a bus master; None is a bus error."""
        if value is not None:
            return value if self.library.machine_bus_write(self.pointer, address, width, value) else None
        answer = self.ffi.new("uint32_t *")
        return int(answer[0]) if self.library.machine_bus_read(self.pointer, address, width, answer) else None


@pytest.fixture
def machine() -> Iterator[Machine]:
    machine = Machine()
    yield machine
    machine.library.machine_bench_operations.destroy(machine.ffi.cast("board_t *", machine.pointer))


def test_events_fire_in_order_of_time_then_of_scheduling(machine: Machine) -> None:
    source = random.Random(7)
    plan: dict[int, tuple[int, int]] = {}
    events = [machine.event() for _ in range(300)]
    for order in range(1500):
        index = source.randrange(len(events))
        if source.random() < 0.2:
            machine.library.machine_cancel(machine.pointer, events[index])
            plan.pop(index, None)
        else:
            time = source.randrange(1, 50)
            machine.library.machine_schedule(machine.pointer, events[index], time)
            plan[index] = (time, order)
    machine.run(25)
    assert all(time < 25 for time, _, _ in machine.fired)
    machine.run(50)
    expected = sorted((time, order, index) for index, (time, order) in plan.items())
    assert [(time, index) for time, index, _ in machine.fired] == [(time, index) for time, _, index in expected]
    assert all(time == now for time, _, now in machine.fired)


def test_bus_master_reaches_sram_and_flash_but_not_ccm(machine: Machine) -> None:
    for width, mask in ((1, 0xFF), (2, 0xFFFF), (4, 0xFFFFFFFF)):
        address = 0x2001FFFC  # Last word of the second SRAM.
        assert machine.bus(address, 0, 4) == 0
        assert machine.bus(address, 0x89ABCDEF & mask, width) is not None
        assert machine.bus(address) == 0x89ABCDEF & mask
    assert machine.bus(0x08000000) == 0xFFFFFFFF  # Erased.
    assert machine.library.machine_bench_violations(machine.pointer) == 0
    errors = [
        (0x10000000, 1),
        (0x10000000, None),
        (0x20020000, 1),
        (0x2001FFFE, 1),
        (0x08000000, 1),
        (0x40000000 - 4, None),
    ]
    for count, (address, value) in enumerate(errors, start=1):
        assert machine.bus(address, value) is None
        assert machine.library.machine_bench_violations(machine.pointer) == count

"""The images' interrupts under the load that costs them most: what `tests/bench/deadline_figures.py` prints, judged."""

from __future__ import annotations

import pytest

from hil_sim import CYCLES_BY_CLASS
from tests.bench.deadline_figures import ENTRY, IMAGES, INTERRUPTS, MASKED, Loaded, measure, response
from tests.firmware.host_rig import MS

SECONDS = 2.5
"""Beacons and anchors drive their coils by then."""
SLOWEST = 2.5
"""Cycles of an instruction with which every deadline must be kept."""


@pytest.fixture(scope="module", params=IMAGES)
def measured(request: pytest.FixtureRequest) -> tuple[str, dict[str, tuple[int, int]]]:
    """An image, and the instructions and cycles of its interrupts."""
    return request.param, measure(request.param, CYCLES_BY_CLASS, SECONDS)


@pytest.mark.parametrize("cycles", [SLOWEST, CYCLES_BY_CLASS])
def test_every_interrupt_is_done_in_time(measured: tuple[str, dict[str, tuple[int, int]]], cycles: float | str) -> None:
    """By response-time analysis: whatever comes together, and not only what came."""
    image, costs = measured
    role = IMAGES[image][0]
    by_class = cycles == CYCLES_BY_CLASS
    ticks = {n: (c if by_class else i * float(cycles)) + ENTRY for n, (i, c) in costs.items()}
    assert {"sync edge", "block", "CAN frame", "CAN stamp in", "drive"} <= costs.keys()
    for name in costs:
        deadline = INTERRUPTS[name].deadline.get(role)
        if deadline is not None:
            assert response(name, ticks, MASKED * SLOWEST) <= deadline, f"{image}: {name}"


@pytest.mark.parametrize("image", IMAGES)
def test_nothing_is_late_or_lost_with_slow_instructions(image: str) -> None:
    """Bursts of the shortest frames, which a sensor's block handler once held up until they overran."""
    loaded = Loaded(image, SLOWEST)
    assert loaded.run(2200 * MS)
    counts, rest = loaded.said()
    loaded.board.close()
    assert counts == {}
    assert not [words for words in rest if "restarted" in words or "cause" in words]

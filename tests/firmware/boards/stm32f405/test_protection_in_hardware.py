"""What stops on the board while a beacon drives its coil, at random phases of chip, block and code.

A hundred of a hundred are to go off in the stated time; ``make protections`` prints how soon they did.
"""

import numpy as np
import pytest

from tests.firmware import host_rig
from tests.firmware.boards.stm32f405.fault_images import (
    ADC,
    CHIP,
    DMA1,
    DMA2,
    DMA2_STREAM1,
    HANG_INTERRUPT,
    HANG_MASKED,
    MASK_INTERRUPT,
    PLANNED,
    RUNNING,
    STOP_ADC,
    STOP_STREAM,
    STOP_TIMER,
    TIM7,
    fault_page,
    off_after,
)
from tests.firmware.host_rig import BEACON, MS, PIN_ENABLE, US, Coil, beacon

AT = 450 * MS
"""When the first fault may come: the board leads, and the current is at its amplitude."""
BOOT = 10 * MS
"""The board's clock starts within that time after it got power."""
TWO_BLOCKS = 62 * CHIP
ONE_MORE = RUNNING + 1
"""Chips where a timer or a stream stops: the chip under way may have had its edges."""
STOPPED = {
    "every interrupt masked": (HANG_MASKED, 0, RUNNING),
    "handler above all others hangs": (HANG_INTERRUPT, TIM7, RUNNING),
    "handler of the currents hangs": (HANG_INTERRUPT, ADC, RUNNING),
    "currents not served": (MASK_INTERRUPT, ADC, RUNNING),
    "converter": (STOP_ADC, 1, RUNNING),
    "timer of the converters": (STOP_TIMER, 4, RUNNING),
    "timer of the chips": (STOP_TIMER, 1, ONE_MORE),
    "timer of the sync wire": (STOP_TIMER, 3, ONE_MORE),
    "timer of the second bridge": (STOP_TIMER, 8, ONE_MORE),
    "stream of the edges": (STOP_STREAM, DMA2 + 4, ONE_MORE),
    "stream of the second bridge": (STOP_STREAM, DMA2 + 1, ONE_MORE),
    "stream of the sync wire": (STOP_STREAM, DMA1 + 2, ONE_MORE),
    "stream of the set-points": (STOP_STREAM, DMA1 + 5, ONE_MORE),
    "stream of the fuse": (STOP_STREAM, DMA2 + 7, ONE_MORE),
    "handler of the blocks hangs": (HANG_INTERRUPT, DMA2_STREAM1, PLANNED + RUNNING),
}
"""What stops, and in how many chips the drive is off."""


def worst(images, monkeypatch, name, seeds):
    """Return the latest end of the drive behind the fault, ps."""
    kind, which, chips = STOPPED[name]
    latest = 0
    monkeypatch.setitem(host_rig.IMAGES, BEACON, str(images["beacon"]))
    for seed in seeds:
        time = AT + int(np.random.default_rng([14, seed]).integers(0, TWO_BLOCKS // US)) * US
        # A conversion that nobody fetches, and one of a converter that is off, are violations.
        board = beacon(Coil(), parameters=fault_page(kind, which, time), emulated=True, strict=False)
        board.run(time - MS)
        assert board.level[PIN_ENABLE]
        board.run(time + BOOT + (chips + 2) * CHIP)
        late = off_after(board)
        assert 0 <= late <= chips * CHIP, f"seed {seed}: off after {late / US:.1f} us"
        assert len(board.edges(PIN_ENABLE)) == 1
        board.close()
        latest = max(latest, late)
    return latest


@pytest.mark.parametrize("name", STOPPED)
def test_what_stops_on_the_board_ends_the_drive_in_the_stated_time(images, monkeypatch, name):
    assert worst(images, monkeypatch, name, range(2)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", STOPPED)
def test_a_hundred_of_a_hundred_that_stop_on_the_board(images, monkeypatch, name):
    latest = worst(images, monkeypatch, name, range(100))
    print(f"{name}, emulated board: 100 of 100, off after {latest / US:.1f} us ({latest / CHIP:.2f} chips) at most")

"""The image on the emulated chip is unlocked by its own random numbers, and not without them.

The model of the generator and its driver are by different hands, from RM0090; what the manual forbids ends the test.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.firmware.host_rig import MS, Coil, beacon
from tests.firmware.services.access_host import (
    CHALLENGE,
    KEY,
    LOCK,
    NO_RANDOM,
    OK,
    OTHER_KEY,
    PARAMETER_LOCKED,
    REFUSED,
    RESET,
    START,
    Host,
    words,
)


@pytest.fixture
def host() -> Iterator[Host]:
    board = beacon(Coil(), parameters={"node": 9, "access_key": words(KEY)}, emulated=True)
    made = Host(board)
    made.clock.now = 100 * MS
    yield made
    board.close()


@pytest.mark.long
def test_the_image_is_locked_and_unlocked(host: Host) -> None:
    assert host.command(START, 65535, named=0, node=0) == 16
    assert host.put(48, 7) == (PARAMETER_LOCKED, 0)
    assert host.unlock(OTHER_KEY) == REFUSED
    host.wait(host.now + 300 * MS)
    assert host.unlock() == OK
    assert host.put(48, 7) == (0, 7)
    assert host.command(LOCK) == OK
    assert not host.changes()
    numbers = set()
    for _ in range(4):
        numbers.add(host.challenge())
        assert host.unlock() == OK  # It is told the same number, which is used up then.
    assert len(numbers) == 4
    assert host.command(RESET) == OK
    host.wait(host.now + 500 * MS)
    assert host.challenge() not in numbers
    assert not host.changes()


@pytest.mark.long
def test_a_noise_source_that_sticks_unlocks_nothing(host: Host) -> None:
    host.wait(host.now)
    host.board.emulator.noise(False, host.now)
    host.wait(host.now + 10 * MS)
    assert host.command(CHALLENGE) == NO_RANDOM
    assert host.answer(0) is None
    assert not host.changes()
    host.board.emulator.noise(True, host.now)
    host.wait(host.now + 10 * MS)
    assert host.unlock() == OK
    assert host.changes()

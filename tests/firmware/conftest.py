"""Host boards of a test, closed behind it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.firmware.host_rig import Board


@pytest.fixture
def boards() -> Iterator[list[Board]]:
    """A list that takes the boards which a test makes."""
    made: list[Board] = []
    yield made
    for board in made:
        board.close()

"""Worlds of a sensor's application on a host board."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from tests.firmware.apps.test_sensor_app import World


@pytest.fixture
def make() -> Iterator[Callable[..., World]]:
    worlds: list[World] = []

    def create(*arguments: object, **options: object) -> World:
        worlds.append(World(*arguments, **options))  # type: ignore[arg-type]
        return worlds[-1]

    yield create
    for world in worlds:
        world.board.close()

"""What the tests of the board share."""

from pathlib import Path

import pytest

from tests.firmware.boards.stm32f405.fault_images import build_images


@pytest.fixture(scope="session")
def images(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The images that stop something of their board, by role."""
    return build_images(tmp_path_factory.mktemp("fault_images"))

"""The pinned packages can be installed for the oldest Python that is promised, as Debian 12 has it."""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parents[2]
PINS = re.findall(r"^([\w.-]+)==", (ROOT / "requirements.txt").read_text(encoding="utf-8"), re.M)
OLDEST = "3.11.2"
"""Python of Debian 12, and of Raspberry Pi OS of 2023."""


def test_the_oldest_python_is_promised() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert OLDEST in SpecifierSet(project["requires-python"])
    assert len(PINS) > 100


@pytest.mark.parametrize("name", PINS)
def test_a_pinned_package_takes_the_oldest_python(name: str) -> None:
    asked = metadata.distribution(name).metadata.json.get("requires_python", "")
    assert OLDEST in SpecifierSet(asked), f"{name} wants Python {asked}: pin an older one"

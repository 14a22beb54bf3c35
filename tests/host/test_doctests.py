"""Every example in a docstring of the host and the protocol is run, in docs/examples, where there are files to read."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import goldfield
import goldfield_protocol

MODULES = ["goldfield"] + [
    name
    for package in (goldfield, goldfield_protocol)
    for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    if not name.endswith("__main__")
]


EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


@pytest.fixture(autouse=True)
def in_examples(monkeypatch):
    monkeypatch.chdir(EXAMPLES)


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_there_are_examples():
    assert sum(doctest.testmod(importlib.import_module(name)).attempted for name in MODULES) >= 8

"""The tool for Python: an alternative does what its name says, and the trace tells where it would."""

import sys
from importlib import import_module

import numpy as np
import pytest

from tests.mutants import py_runtime
from tests.mutants.mutant import with_distinct_names
from tests.mutants.py_sites import Finder, Instrumented

SOURCE = '''"""A small module."""

from __future__ import annotations

MOST = 8
HOT = 300.0


class Counter:
    """Counts."""

    def __init__(self, names: list[str] | None = None) -> None:
        self.names = names or ["none"]
        self.count = 0

    def add(self, some: int = 1) -> int:
        """Add some."""
        self.count += some
        return self.count


def fits(length: int, wanted: bool) -> bool:
    """Whether it fits."""
    return bool(length <= MOST and wanted)


def hot(kelvin):
    """Which are hot."""
    return kelvin > HOT


def halved(a: float, b: float) -> float:
    """Half a difference."""
    return -(a - b) / 2 if a > 0 else 0.0
'''


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """(mutants, module)."""
    folder = tmp_path_factory.mktemp("small")
    path = folder / "small_for_mutants.py"
    path.write_text(SOURCE)
    made = Instrumented("small.py", SOURCE)
    finder = Finder({path: made}, "small_for_mutants")
    sys.meta_path.insert(0, finder)
    sys.path.insert(0, str(folder))
    try:
        module = import_module("small_for_mutants")
    finally:
        sys.meta_path.remove(finder)
        sys.path.remove(str(folder))
        sys.modules.pop("small_for_mutants", None)
    return with_distinct_names(made.mutants), module


@pytest.fixture
def runtime():
    """The runtime, put back afterwards."""
    yield py_runtime
    py_runtime.mutant, py_runtime.tracing = 0, False
    for numbers in (py_runtime.infected, py_runtime.applicable, py_runtime.reached):
        numbers.clear()


def number_of(small, what):
    (number,) = [mutant.number for mutant in small[0] if mutant.what == what]
    return number


def test_without_a_mutant_all_is_as_it_was(small):
    module = small[1]
    assert [module.fits(n, True) for n in (0, 8, 9)] == [True, True, False]
    assert module.hot(np.array([300.0, 301.0])).tolist() == [False, True]
    assert (module.halved(4.0, 2.0), module.halved(-1.0, 0.0)) == (-1.0, 0.0)
    assert (module.Counter().names, module.Counter(["a"]).names, module.Counter().add(3)) == (["none"], ["a"], 3)


@pytest.mark.parametrize(
    ("what", "call", "expected"),
    [
        ("`length <= MOST` with < for <=", lambda m: m.fits(8, True), False),
        ("`length <= MOST` with its constant one further", lambda m: m.fits(9, True), True),
        ("`length <= MOST and wanted` with or", lambda m: m.fits(100, True), True),
        (
            "`kelvin > HOT` with its constant times 1.1",
            lambda m: m.hot(np.array([329.0, 331.0])).tolist(),
            [False, True],
        ),
        ("`kelvin > HOT` is always false", lambda m: m.hot(np.array([400.0, 0.0])).tolist(), [False, False]),
        ("`kelvin > HOT` is always true", lambda m: m.hot(0.0), True),
        ("`a - b` with + for -", lambda m: m.halved(4.0, 2.0), -3.0),
        ("`-(a - b)` loses its -", lambda m: m.halved(4.0, 2.0), 1.0),
        ("`2` in `-(a - b) / 2` is more", lambda m: m.halved(5.0, 2.0), -1.0),
        ("`names or ['none']` with and", lambda m: m.Counter(["a"]).names, ["none"]),
        ("`self.count += some` is left out", lambda m: m.Counter().add(3), 0),
        ("`self.count += some` with -= for +=", lambda m: m.Counter().add(3), -3),
    ],
)
def test_a_mutant_does_what_its_name_says(small, runtime, what, call, expected):
    runtime.mutant = number_of(small, what)
    assert call(small[1]) == expected


def test_only_what_functions_compute_is_changed(small):
    functions = {mutant.function for mutant in small[0]}
    assert functions == {"Counter.__init__", "Counter.add", "fits", "hot", "halved"}
    assert not [mutant.what for mutant in small[0] if "some: int" in mutant.what or "MOST = 8" in mutant.what]


def test_the_trace_tells_what_would_make_a_difference(small, runtime):
    boundary = number_of(small, "`length <= MOST` with < for <=")
    farther = number_of(small, "`length <= MOST` with its constant one further")
    scaled = number_of(small, "`length <= MOST` with its constant times 1.1")
    runtime.tracing = True
    for length, expected in ((7, (False, False)), (9, (False, True)), (8, (True, True))):
        assert small[1].fits(length, True) == (length <= 8)
        assert (boundary in runtime.infected, farther in runtime.infected) == expected
    assert scaled in runtime.reached
    assert scaled not in runtime.applicable  # A whole number has a neighbour, and no tenth.

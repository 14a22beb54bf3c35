"""The tool itself: each alternative of a small source does what its name says, and nothing else is changed."""

import ctypes
import fcntl
import re
import subprocess

import numpy as np
import pytest

from tests.mutants import c_build
from tests.mutants.c_build import COMPILE, FRONT, HERE
from tests.mutants.c_sites import Instrumented
from tests.mutants.mutant import with_distinct_names

SOURCE = b"""
#include <stdbool.h>
#define MOST 8u
static const int table[2] = {3, 4};
enum { SIZE = 2 + 1 };
_Static_assert(SIZE > 2, "three");
bool fits(unsigned length, bool wanted) { return length <= MOST && wanted; }
bool is_hot(float kelvin) { return kelvin > 300.0f; }
int sum(int a, int b) {
    int kept[SIZE] = {0};
    kept[1] = a + b;
    switch (a) {
    case 7:
        kept[1] -= 2;
        break;
    default:
        break;
    }
    for (int i = 0; i < 2; i++) {
        kept[1] += table[i] << i;
    }
    return !b ? -a : kept[1];
}
"""


def built(folder, flags=()):
    """Return the mutants of `SOURCE` and the library that holds them."""
    made = Instrumented("small.c", SOURCE)
    (folder / "small.c").write_text(made.text)
    count = f"-DGF_COUNT={len(made.mutants) + 1}"
    library = folder / "small.so"
    files = [folder / "small.c", HERE / "mutants.c"]
    subprocess.run([*COMPILE, *FRONT, *flags, count, "-shared", *map(str, files), "-o", str(library)], check=True)
    opened = ctypes.CDLL(str(library))
    opened.is_hot.argtypes = [ctypes.c_float]
    return with_distinct_names(made.mutants), opened


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return built(tmp_path_factory.mktemp("small"))


def as_mutant(small, what, call):
    """Return what a call gives under the one mutant of that name."""
    mutants, library = small
    (number,) = [mutant.number for mutant in mutants if mutant.what == what]
    active = ctypes.c_int.in_dll(library, "gf_mutant")
    active.value = number
    try:
        return call(library)
    finally:
        active.value = 0


def test_without_a_mutant_all_is_as_it_was(small):
    _, library = small
    assert [library.fits(n, True) & 1 for n in (0, 8, 9)] == [1, 1, 0]
    assert [library.is_hot(x) & 1 for x in (300.0, 301.0)] == [0, 1]
    assert [library.sum(a, b) for a, b in ((1, 2), (7, 2), (5, 0))] == [14, 18, -5]


@pytest.mark.parametrize(
    ("what", "call", "expected"),
    [
        ("`length <= MOST` with < for <=", lambda c: c.fits(8, True) & 1, 0),
        ("`length <= MOST` with its constant + 1", lambda c: c.fits(9, True) & 1, 1),
        ("`length <= MOST` is always true", lambda c: c.fits(100, True) & 1, 1),
        ("`length <= MOST && wanted` with ||", lambda c: c.fits(100, True) & 1, 1),
        ("`wanted` is always false", lambda c: c.fits(0, True) & 1, 0),
        ("`kelvin > 300.0f` with its constant times 1.1", lambda c: c.is_hot(329.0) & 1, 0),
        ("`kelvin > 300.0f` with its constant times 0.9", lambda c: c.is_hot(271.0) & 1, 1),
        ("`a + b` with - for +", lambda c: c.sum(1, 2), 10),
        ("`kept[1] = a + b;` is left out", lambda c: c.sum(1, 2), 11),
        ("`kept[1] -= 2` with += for -=", lambda c: c.sum(7, 2), 22),
        ("`2` in `kept[1] -= 2` is more", lambda c: c.sum(7, 2), 17),
        ("`table[i] << i` with >> for <<", lambda c: c.sum(1, 2), 8),
        ("`i < 2` with <= for <", lambda c: c.sum(1, 2) != 14, True),
        ("`-a` loses its -", lambda c: c.sum(5, 0), 5),
        ("`!b` is always true", lambda c: c.sum(5, 1), -5),
    ],
)
def test_a_mutant_does_what_its_name_says(small, what, call, expected):
    assert as_mutant(small, what, call) == expected


def test_what_is_not_computed_at_run_time_is_left_alone(small):
    mutants, _ = small
    assert {mutant.function for mutant in mutants} == {"fits", "is_hot", "sum"}
    assert not [m.what for m in mutants if "SIZE" in m.what or "{3, 4}" in m.what or "`7`" in m.what or "{0}" in m.what]
    assert len({mutant.name for mutant in mutants}) == len(mutants)


def test_the_trace_tells_what_would_make_a_difference(tmp_path):
    mutants, library = built(tmp_path, ("-DGF_TRACE",))
    infected = (ctypes.c_ubyte * (len(mutants) + 1)).in_dll(library, "gf_infected")
    number = {mutant.what: mutant.number for mutant in mutants}
    boundary, farther = (number[f"`length <= MOST` with {change}"] for change in ("< for <=", "its constant + 1"))
    for length, expected in ((7, (0, 0)), (9, (0, 1)), (8, (1, 1))):
        assert library.fits(length, True) & 1 == (length <= 8)
        assert (infected[boundary], infected[farther]) == expected


def test_one_process_builds_at_a_time(monkeypatch, tmp_path):
    """Two would compile each other's sources, and their mutants would not be those of their numbers."""

    def is_locked(_workers):
        with (tmp_path / "build.lock").open("w") as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return "built"

    monkeypatch.setattr(c_build, "OUT", tmp_path)
    monkeypatch.setattr(c_build, "_build", is_locked)
    assert c_build.build() == "built"


def test_the_figures_of_the_page_add_up():
    """Its prose tells the sums of its table, in which each mutant is killed, named or neither."""
    page = (HERE / "README.md").read_text()
    rows = [re.findall(r"\| (\d+) (?=\|)", row + "|") for row in page.splitlines() if row.endswith("| 0 |")]
    counts = [[int(count) for count in row[-4:]] for row in rows]
    assert all(mutants == killed + named + unnamed for mutants, killed, named, unnamed in counts)
    said = r"So far ([\d,]+) of the core and ([\d,]+) of the locator .*: ([\d,]+) were killed, ([\d,]+) are named"
    told = re.search(said, " ".join(page.split()))
    core, locator, *rest = (int(number.replace(",", "")) for number in told.groups())
    mutants, killed, named, _ = np.sum(counts, axis=0)
    assert [core + locator, *rest] == [mutants, killed, named]

"""Which code comes and goes, of fields that are made by hand."""

import numpy as np
import pytest

from goldfield.nodes.signature import Seen, Watch
from goldfield_protocol.messages import Message

NOISE_T = 6e-9
"""The noise of a cycle's field: a 32nd of 2e-7 T."""
LEAK = 65.0 / 1023.0


def watched(fields_T, toggling, *, cycles=20, seed=1, first=0, lost=()):
    """Feed what sensor 100 reports of codes 2, 3, ... whose beacon of that index toggles (None: nobody)."""
    random = np.random.default_rng(seed)
    watch = Watch()
    for cycle in range(first, first + cycles):
        true = np.array(fields_T, dtype=float)
        if toggling is not None and cycle % 2:
            true[toggling] *= 0.5
        total = true.sum(axis=0)
        for code, own in enumerate(true):
            field = own + LEAK * (total - own) + random.normal(0.0, NOISE_T, 3)
            if cycle not in lost:
                signals = dict(zip("xyz", field, strict=True)) | {"cycle_low": cycle % 16}
                watch.take(Message("FIELD", 100, code + 2, signals))
    return watch


FIELDS = np.array([[4e-6, 1e-6, 0.0], [0.0, 3e-7, 3e-7], [-5e-6, 0.0, 1e-6], [1e-6, 1e-6, 1e-6]])


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("lost", [(), (1, 2, 5, 9, 11, 12)])
def test_the_code_that_toggles_is_found_beside_stronger_ones(which, lost):
    (seen,) = watched(FIELDS, which, lost=lost).seen()
    assert (seen.sensor, seen.code) == (100, which + 2)
    assert seen.change_T == pytest.approx(0.5 * np.linalg.norm(FIELDS[which]), rel=0.1)


def test_nothing_is_found_where_nothing_toggles():
    assert [watched(FIELDS, None, seed=seed).seen() for seed in range(50)] == 50 * [[]]


def test_what_only_leaks_into_the_codes_that_are_reported_is_not_one_of_them():
    watch = watched(np.array([[4e-6, 1e-6, 0.0], [0.0, 3e-7, 3e-7], [8e-6, 0.0, 0.0]]), 2)
    for key in [key for key in watch._fields if key[1] == 4]:
        del watch._fields[key]
    assert watch.seen() == []


@pytest.mark.parametrize(("cycles", "found"), [(5, 0), (6, 1)])
def test_so_many_cycles_are_needed(cycles, found):
    seen = watched(FIELDS, 0, cycles=cycles).seen()
    assert len(seen) == found
    assert all(isinstance(one, Seen) for one in seen)

"""Random numbers of the world, against their distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hil_sim import clib

SEED, COUNT = 5, 400_000
CHANCE = 1e-4
"""A test of the distribution that says so by chance."""


@pytest.fixture(scope="module")
def library():
    return clib.load("build/libgf_rig.so", ["world/noise.h", "world/noise_layers.h"])[1]


@pytest.fixture(scope="module")
def normal(library):
    stream = library.noise_stream(SEED, library.NOISE_CURRENT_SENSE, 7, 0)
    return np.array([library.noise_normal(stream, 97_750_000 * k) for k in range(COUNT)])


def test_normal_numbers_are_distributed_as_such(normal):
    assert stats.kstest(normal, "norm").pvalue > CHANCE
    edges = stats.norm.ppf(np.linspace(0.0, 1.0, 1001))  # so fine that each layer's edge is in a bin of its own
    assert stats.chisquare(np.histogram(normal, edges)[0]).pvalue > CHANCE


@pytest.mark.parametrize("beyond", [3.0, 3.6541528853610088, 4.0, 4.5])
def test_tails_of_both_sides_are_as_heavy(normal, beyond):
    """The lowest layer ends at 3.654; what is beyond comes of another formula."""
    for side in (normal, -normal):
        found = int(np.count_nonzero(side > beyond))
        assert stats.binomtest(found, COUNT, stats.norm.sf(beyond)).pvalue > CHANCE
    tail = np.abs(normal[np.abs(normal) > beyond])
    assert stats.kstest(tail, lambda x: 1.0 - stats.norm.sf(x) / stats.norm.sf(beyond)).pvalue > CHANCE


def test_numbers_of_different_addresses_are_independent(library, normal):
    other = library.noise_stream(SEED, library.NOISE_CURRENT_SENSE, 7, 1)
    beside = np.array([library.noise_normal(other, 97_750_000 * k) for k in range(COUNT // 10)])
    for one, another in ((normal[1:], normal[:-1]), (normal[: len(beside)], beside)):
        for power in (1, 2):
            assert stats.pearsonr(one**power, another**power).pvalue > CHANCE


def test_a_number_is_a_function_of_its_address(library, normal):
    stream = library.noise_stream(SEED, library.NOISE_CURRENT_SENSE, 7, 0)
    assert library.noise_normal(stream, 97_750_000 * 77) == normal[77]
    streams = [library.noise_stream(*address) for address in np.ndindex(5, 5, 5, 5)]
    assert len({library.noise_bits(stream, k) for stream in streams for k in range(5)}) == 5**5


def test_uniform_numbers_are_distributed_as_such(library):
    stream = library.noise_stream(SEED, library.NOISE_IMPULSE, 0, 0)
    values = np.array([library.noise_uniform(stream, k) for k in range(COUNT)])
    assert stats.kstest(values, "uniform").pvalue > CHANCE


def test_layers_have_the_same_area(library):
    edges = np.array(list(library.noise_layers))
    density = np.exp(-0.5 * edges**2)
    area = edges[1] * density[1] + np.sqrt(2.0 * np.pi) * stats.norm.sf(edges[1])
    np.testing.assert_allclose(edges[1:-1] * np.diff(density[1:]), area, rtol=1e-12)
    assert edges[0] * density[1] == pytest.approx(area, rel=1e-14)
    assert edges[-1] == 0.0
    assert len(edges) == library.NOISE_LAYERS + 1

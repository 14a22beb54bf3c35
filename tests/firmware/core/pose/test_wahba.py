"""The rotation between two sets of vectors, and what is left of them: scipy's, by the singular value decomposition."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

IDENTITY = [0.0, 0.0, 0.0, 1.0]


def computed(core, site, sensor, weight):
    """(loss, energy, rotation) of pairs; a fourth component behind each vector is nobody's."""
    ffi, lib = core
    wahba, quaternion = ffi.new("wahba_t[2]", [{"h": [[7.0] * 3] * 3, "energy": 7.0}]), ffi.new("float[4]", [7.0] * 4)
    lib.wahba_init(wahba)
    for a, b, w in zip(site.tolist(), sensor.tolist(), weight.tolist(), strict=True):
        lib.wahba_add(wahba, ffi.new("float[4]", [*a, 7.0]), ffi.new("float[4]", [*b, 7.0]), w)
    lib.wahba_rotation(wahba, quaternion)
    return lib.wahba_loss(wahba), wahba[0].energy, list(quaternion)


def energy_of(site, sensor, weight):
    return (weight * ((site**2).sum(axis=1) + (sensor**2).sum(axis=1))).sum()


@pytest.mark.parametrize("count", [2, 3, 8])
def test_nearly_the_same_vectors(core, count):
    rng = np.random.default_rng(count)
    for rotation in Rotation.random(100, random_state=np.random.default_rng(1)):
        sensor = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-1, 1, (count, 1))
        site = rotation.apply(sensor) * rng.uniform(0.9, 1.1, (count, 1)) + rng.normal(0, 0.02, (count, 3))
        if np.linalg.norm(np.cross(sensor[0], sensor[1])) < 0.3 * np.linalg.norm(sensor[0]) * np.linalg.norm(sensor[1]):
            continue  # Nearly parallel: no attitude.
        weight = 1.0 / (0.01 + 0.1 * (sensor**2).sum(axis=1))
        loss, energy, quaternion = computed(core, site, sensor, weight)
        best, _ = Rotation.align_vectors(site, sensor, weights=weight)
        least = (weight * ((site - best.apply(sensor)) ** 2).sum(axis=1)).sum()
        assert energy == pytest.approx(energy_of(site, sensor, weight), rel=1e-5)
        assert (Rotation.from_quat(quaternion) * best.inv()).magnitude() < 0.02
        assert loss == pytest.approx(least, abs=1e-3 * energy)


def apart(strengths, mirrored, rng):
    """Three pairs at right angles to each other, the site's longer or shorter; one is turned about in a mirror."""
    turns = Rotation.random(2, random_state=rng)
    axes = np.diag(strengths)
    return turns[0].apply(axes), turns[1].apply(axes * [1.0, 1.0, -1.0 if mirrored else 1.0])


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_vectors_in_clearly_different_directions(core, share, mirrored):
    """1e-4 of the energy and 1e-3 rad, also where the vectors of the two frames are no rotation of each other."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        site, sensor = apart(rng.permutation([1.0, 0.8, 0.4]) if mirrored else rng.uniform(0.7, 1.0, 3), mirrored, rng)
        site, weight = share * site, rng.uniform(0.9, 1.1, 3)
        loss, energy, quaternion = computed(core, site, sensor, weight)
        best, _ = Rotation.align_vectors(site, sensor, weights=weight)
        least = (weight * ((site - best.apply(sensor)) ** 2).sum(axis=1)).sum()
        assert loss == pytest.approx(least, abs=1e-4 * energy)
        assert loss >= 0.0
        assert (Rotation.from_quat(quaternion) * best.inv()).magnitude() < 1e-3
        assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("share", [1.0, 0.7, 0.3])
def test_parallel_vectors(core, share):
    """Their rotation is one of many, and the loss is rounded where the quartic is flat."""
    sizes, way = np.array([0.2, 1.7, 0.9]), np.array([0.0, 0.6, 0.8])
    for turn in Rotation.random(100, random_state=np.random.default_rng(5)):
        sensor = turn.apply(np.outer(sizes, way))
        loss, energy, quaternion = computed(core, share * np.outer(sizes, way), sensor, np.ones(3))
        assert loss == pytest.approx(((1.0 - share) ** 2 * sizes**2).sum(), abs=3e-4 * energy)
        assert loss >= 0.0
        assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-6)


def test_vectors_much_shorter_than_the_others(core):
    """The steps end 3.5 % of the energy above: from 1 to the root of lambda^4 each goes a quarter."""
    site, sensor = apart([1.0, 0.9, 0.8], False, np.random.default_rng(6))
    loss, energy, _ = computed(core, 1e-6 * site, sensor, np.ones(3))
    assert 0.0 < energy - loss < 0.035 * energy


def test_what_tells_no_rotation_is_none(core):
    """No pairs, or one along an axis, whose zeta is 0 exactly."""
    for site in (np.zeros((0, 3)), np.array([[1.0, 0.0, 0.0]])):
        loss, energy, quaternion = computed(core, site, site, np.ones(len(site)))
        assert (loss, energy) == (0.0, 2.0 * len(site))
        assert quaternion == IDENTITY

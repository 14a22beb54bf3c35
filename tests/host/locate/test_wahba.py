"""Wahba's problem against SciPy's solver."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.wahba import wahba, wahba_loss


def noisy_pairs(seed, count=30, vectors=5):
    rng = np.random.default_rng(seed)
    truth = Rotation.random(count, rng=rng).as_matrix()
    sensor = rng.normal(size=(count, vectors, 3))
    site = np.einsum("eij,enj->eni", truth, sensor) + 0.1 * rng.normal(size=sensor.shape)
    return site, sensor, rng.uniform(0.1, 2.0, size=(count, vectors))


def test_rotation_is_scipys():
    site, sensor, weight = noisy_pairs(1)
    ours = wahba(site, sensor, weight)
    for e in range(len(site)):
        theirs = Rotation.align_vectors(site[e], sensor[e], weights=weight[e])[0].as_matrix()
        np.testing.assert_allclose(ours[e], theirs, atol=1e-9)


def test_two_vectors_are_enough():
    site, sensor, weight = noisy_pairs(2, vectors=2)
    ours = wahba(site, sensor, weight)
    np.testing.assert_allclose(np.linalg.det(ours), 1.0, atol=1e-12)
    expected = Rotation.align_vectors(site[0], sensor[0], weights=weight[0])[0].as_matrix()
    np.testing.assert_allclose(ours[0], expected, atol=1e-9)


def test_weight_zero_leaves_a_pair_out():
    site, sensor, weight = noisy_pairs(3)
    weight[:, 2] = 0.0
    spoiled = site.copy()
    spoiled[:, 2] = 1e3
    np.testing.assert_allclose(wahba(spoiled, sensor, weight), wahba(site, sensor, weight), atol=1e-9)


def test_loss_is_that_of_the_best_rotation():
    rng = np.random.default_rng(4)
    site, sensor, weight = noisy_pairs(4)
    unrelated = rng.normal(size=site.shape)  # also far from any solution, where Newton starts from the bound
    for vectors in (site, unrelated, -site):
        rotation = wahba(vectors, sensor, weight)
        turned = np.einsum("eij,enj->eni", rotation, sensor)
        expected = np.einsum("en,enc->e", weight, (vectors - turned) ** 2)
        np.testing.assert_allclose(wahba_loss(vectors, sensor, weight), expected, rtol=1e-3)

"""Poses from fields: the locator beside SciPy's and GTSAM's optimisers, by the same steps from the same start.

SciPy differentiates by differences, as it does unless told otherwise; GTSAM is given the derivatives of our field
model, as it cannot do without. Neither tells whether a pose can be believed, which the locator does for every one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.locate.starts import simple_magnitudes
from goldfield.locate.wahba import wahba
from goldfield.types import Fields
from tests.bench import locate_trials as trials
from tests.bench.locate_speed import with_scipy
from tests.bench.peers.bench import Bench, named
from tests.bench.peers.row import Goal, Row

SUBJECT = "location"
EPOCHS, SOME = 2000, 20
SINGLE, BATCHED = 30.0, 300.0
"""How many times SciPy's time the issue asks for."""


class WithGtsam:
    """Locates an epoch by the steps of `with_scipy`: magnitudes, Wahba's rotation, fields with and without a margin."""

    def __init__(self, model: FieldModel) -> None:
        import gtsam

        self._gtsam, self._model = gtsam, model
        self._settings = gtsam.LevenbergMarquardtParams()

    def __call__(self, epoch: Fields) -> Any:
        """Return the position."""
        model, magnitude = self._model, np.linalg.norm(epoch.field_T, axis=1)
        known = np.ones((1, len(model)), dtype=bool)
        start = simple_magnitudes(model, magnitude[None], epoch.sigma_T[None], known)[0]
        weight = 1.0 / np.hypot(0.1, epoch.sigma_T / magnitude)

        def of_logarithms(_: Any, values: Any, derivatives: Any) -> Any:
            field, gradient = model.field_and_gradient(values.atPoint3(1))
            size = np.linalg.norm(field, axis=1)
            if derivatives is not None:
                derivatives[0] = np.asfortranarray(
                    -weight[:, None] * np.einsum("ni,nij->nj", field, gradient) / size[:, None] ** 2
                )
            return weight * (np.log(magnitude) - np.log(size))

        position = self._solved(of_logarithms, len(model), "insertPoint3", start).atPoint3(1)
        rotation = wahba(model.field(position), epoch.field_T, 1.0 / epoch.sigma_T**2)
        pose = self._gtsam.Pose3(self._gtsam.Rot3(rotation), position)
        for margin in (0.03, 0.0):
            sigma = np.hypot(epoch.sigma_T, margin * magnitude)[:, None]

            def of_fields(_: Any, values: Any, derivatives: Any, sigma: Any = sigma) -> Any:
                at = values.atPose3(1)
                turn = at.rotation().matrix()
                field, gradient = model.field_and_gradient(at.translation())
                seen = field @ turn
                if derivatives is not None:
                    moved = np.einsum("ki,nkl,lj->nij", turn, gradient, turn)
                    turned = np.cross(seen[:, None, :], np.eye(3)[None]).swapaxes(1, 2)
                    both = -np.concatenate([turned, moved], axis=2) / sigma[:, :, None]
                    derivatives[0] = np.asfortranarray(both.reshape(-1, 6))
                return ((epoch.field_T - seen) / sigma).ravel()

            pose = self._solved(of_fields, 3 * len(model), "insert", pose).atPose3(1)
        return pose.translation()

    def _solved(self, error: Any, count: int, insert: str, start: Any) -> Any:
        gtsam = self._gtsam
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(count), [1], error))
        getattr(values, insert)(1, start)
        return gtsam.LevenbergMarquardtOptimizer(graph, values, self._settings).optimize()


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject; all ways must find the poses."""
    site, rng = trials.prigge_cube(), np.random.default_rng(106)
    run = trials.trials(site, trials.cube_positions(rng, EPOCHS), rng)
    locator, fields = Locator(site), trials.fields_of(site, run)
    some, few = fields[:SOME], run.position_m[:SOME]
    near_m = np.maximum(0.01, 8 * trials.bound_of(site, run)[:SOME])

    def check(positions: list[Any]) -> None:
        off = np.linalg.norm(np.array(positions) - few, axis=1)
        assert (off < near_m).mean() >= 0.9, off

    def single() -> list[Any]:
        return [locator.locate(epoch).position_m for epoch in some]

    def batched() -> Any:
        return locator.locate_many(fields)

    def scipy() -> list[Any]:
        return [with_scipy(locator.model, epoch) for epoch in some]

    check(single())
    check(scipy())
    one, many = "a pose of 8 beacons, one by one", f"a pose of 8 beacons, {EPOCHS:,} in a call"
    by_scipy = f"{named('scipy')}, least_squares"
    found = [
        bench.pair(SUBJECT, one, single, by_scipy, scipy, work=SOME, goal=Goal("ratio", at_least=SINGLE)),
        bench.pair(
            SUBJECT,
            many,
            batched,
            f"{by_scipy}, one by one",
            scipy,
            work=EPOCHS,
            their_work=SOME,
            goal=Goal("ratio", at_least=BATCHED),
        ),
    ]
    try:
        gtsam = WithGtsam(locator.model)
    except ImportError:
        return found

    def by_gtsam() -> list[Any]:
        return [gtsam(epoch) for epoch in some]

    check(by_gtsam())
    return [*found, bench.pair(SUBJECT, one, single, f"{named('gtsam')}, LevenbergMarquardt", by_gtsam, work=SOME)]

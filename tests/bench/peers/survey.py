"""A survey of eight beacons from a walk, beside SciPy's optimiser on the same unknowns from the same start.

The unknowns are place, axis and current of each beacon, the sensor's own matrix, and each epoch's pose. SciPy gets the
pattern of its sparse derivatives and finds their values by differences. A survey of ours also looks for what is wrong
in the data, and states the covariance of what it finds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from goldfield.locate import Locator
from goldfield.survey import survey
from tests.bench.integrity_coils import Coils
from tests.bench.peers.bench import Bench, named
from tests.bench.peers.row import Row
from tests.bench.survey_trials import ASTRAY, POINT_SD_M, Trial, cube, trial

SUBJECT = "survey"
EPOCHS, SEED = 60, 5
OF_BEACON, OF_POSE = 7, 6
GAIN_SD = 0.02
NEAR_M = 0.03
EVALUATIONS = 300
"""Half a minute of SciPy: as near to the beacons as ours comes, though its sum of squares would still fall."""


class Bundle:
    """The whole survey as one problem of least squares: what SciPy is given."""

    def __init__(self, work: Trial) -> None:
        site = work.site
        self._count = len(site.beacons)
        located = Locator(site).locate_many(list(work.data.epochs))
        self._at = np.array([pose.position_m for pose in located])
        self._at = np.where(np.isfinite(self._at), self._at, np.array([1.0, 1.0, 0.9]))
        turns = np.array([pose.orientation_xyzw for pose in located])
        turns[~np.isfinite(turns).all(axis=1)] = [0.0, 0.0, 0.0, 1.0]
        self._turn = Rotation.from_quat(turns).as_matrix()
        self._field = np.array([epoch.field_T for epoch in work.data.epochs])
        self._sigma = np.array([epoch.sigma_T for epoch in work.data.epochs])[:, :, None]
        self._coils = Coils.of(site, EPOCHS)
        number = {epoch.epoch: row for row, epoch in enumerate(work.data.epochs)}
        self._known = np.array([number[point.epoch] for point in work.data.points])
        self._places = np.array([point.position_m for point in work.data.points])
        sd = [*[ASTRAY.position_m] * 3, *[ASTRAY.axis_rad] * 3, ASTRAY.current]
        self._prior = np.concatenate([np.tile(sd, self._count), np.full(9, GAIN_SD)])
        self.unknowns = len(self._prior) + OF_POSE * EPOCHS

    def _parts(self, x: Any) -> tuple[Any, Any, Any]:
        beacons = x[: OF_BEACON * self._count].reshape(self._count, OF_BEACON)
        matrix = np.eye(3) + x[OF_BEACON * self._count : len(self._prior)].reshape(3, 3)
        return beacons, matrix, x[len(self._prior) :].reshape(EPOCHS, OF_POSE)

    def residuals(self, x: Any) -> Any:
        """Return fields, known points and what the site's file said, each over its deviation."""
        beacons, matrix, poses = self._parts(x)
        coils = self._coils.moved(beacons[:, :3]).turned(beacons[:, 3:6]).scaled(np.exp(beacons[:, 6]))
        place = self._at + poses[:, :3]
        turn = Rotation.from_rotvec(poses[:, 3:]).as_matrix() @ self._turn
        seen = np.einsum("ij,ekj,enk->eni", matrix, turn.swapaxes(1, 2), coils.field(place))
        fields = (self._field - seen) / self._sigma
        points = (place[self._known] - self._places) / POINT_SD_M
        return np.concatenate([fields.ravel(), points.ravel(), x[: len(self._prior)] / self._prior])

    def pattern(self) -> Any:
        """Return which residual depends on which unknown."""
        fields, priors = 3 * self._count * EPOCHS, len(self._prior)
        rows = fields + 3 * len(self._known) + priors
        found = lil_matrix((rows, self.unknowns), dtype=np.int8)
        found[:fields, OF_BEACON * self._count : priors] = 1
        for epoch in range(EPOCHS):
            first, pose = 3 * self._count * epoch, priors + OF_POSE * epoch
            found[first : first + 3 * self._count, pose : pose + OF_POSE] = 1
            for beacon in range(self._count):
                row = first + 3 * beacon
                found[row : row + 3, OF_BEACON * beacon : OF_BEACON * (beacon + 1)] = 1
        for number, epoch in enumerate(self._known):
            first, pose = fields + 3 * number, priors + OF_POSE * epoch
            found[first : first + 3, pose : pose + 3] = 1
        for number in range(priors):
            found[rows - priors + number, number] = 1
        return found

    def solved(self) -> Any:
        """Return the places of the beacons, shape (n, 3)."""
        start = np.zeros(self.unknowns)
        x = least_squares(self.residuals, start, jac_sparsity=self.pattern(), x_scale="jac", max_nfev=EVALUATIONS).x
        return self._coils.position_m[0] + self._parts(x)[0][:, :3]


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject; both must find the beacons."""
    work = trial(cube(), SEED, epochs=EPOCHS)
    truth = work.coils.position_m[0]

    def ours() -> Any:
        return np.array([beacon.position_m for beacon in survey(work.site, work.data).site.beacons])

    def theirs() -> Any:
        return Bundle(work).solved()

    for found in (ours(), theirs()):
        assert np.linalg.norm(found - truth, axis=1).max() < NEAR_M, found - truth
    what = f"a survey of 8 beacons from {EPOCHS} epochs and 10 known points"
    peer = f"{named('scipy')}, least_squares"
    return [Bench(1, bench.clock, bench.memory).pair(SUBJECT, what, ours, peer, theirs, unit="ms")]

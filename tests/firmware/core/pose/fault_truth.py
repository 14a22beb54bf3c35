"""Faults of a fitted pose by plain least squares in double precision: one more fit for each question.

The board asks with Cholesky factors, projections and cumulants in single precision what each explanation would take
away of the cost. Here the explanation becomes columns of the problem, which is solved again; a beacon left out has
rows of 0. Derivatives are differences of magpylib's fields.
"""

from dataclasses import dataclass

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

FALSE_ALARM = 7e-4
LIMITS = {"beacon": (0.3 / 16, 3), "strength": (0.2 / 16, 1), "gain": (0.2, 1), "gains": (0.1, 3), "skew": (0.1, 6)}
"""The share of false alarms of each test, of a beacon among sixteen, and its degrees of freedom."""
AXES = [np.diag(row) for row in np.eye(3)]
SKEWS = [np.array(m) for m in ([[0, 0, 0], [0, 0, 1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [1, 0, 0]])]
SKEWS.append(np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]]))


def field_T(beacon, points):
    """The field of a beacon, shape of the points."""
    coil = magpylib.current.Circle(
        current=beacon.turns * beacon.current_A,
        diameter=2 * beacon.radius_m,
        position=beacon.position_m,
        orientation=Rotation.align_vectors(beacon.axis[None], [[0.0, 0.0, 1.0]])[0],
    )
    return coil.getB(points)


WAYS = 1e-5 * np.vstack([np.eye(3), -np.eye(3)])


def slope(values):
    """Central differences of values at the six `WAYS`, a column for each of three numbers."""
    return ((values[:3] - values[3:]) / 2e-5).T


def derivatives(beacon, position):
    """The field at a position, what moving it does, and what turning the coil about its centre does."""
    turns, arm = Rotation.from_rotvec(WAYS), position - beacon.position_m
    fields = field_T(beacon, np.vstack([position, position + WAYS, beacon.position_m + turns.inv().apply(arm)]))
    return fields[0], slope(fields[1:7]), slope(turns.apply(fields[7:]))


@dataclass
class Truth:
    """The whitened problem around a pose: what is left, by the six unknowns and the sensor's six, in rows of beacons.

    ``residual`` has shape (3n,), ``rows`` (3n, 6), ``sensor`` (3n, 6), ``model`` (n, 3), T; ``whitening`` (n, 3, 3).
    """

    site: object
    attitude: np.ndarray
    residual: np.ndarray
    rows: np.ndarray
    sensor: np.ndarray
    model: np.ndarray
    whitening: np.ndarray

    @classmethod
    def around(cls, site, fields, sigma_T, position, rotation):
        attitude = rotation.as_matrix()
        model, white, rows, sensor = [], [], [], []
        pairs = np.sqrt(0.5) * np.array(SKEWS[::-1])
        for b, measured, sd_T in zip(site.beacons, fields, sigma_T, strict=True):
            here, gradient, leaning = derivatives(b, position)
            place, lean = b.survey.position_sd_m * gradient, b.survey.axis_sd_rad * leaning
            noise = (sd_T**2 + (1e-6 * np.linalg.norm(measured)) ** 2) * np.eye(3)
            cov = noise + place @ place.T + lean @ lean.T + b.survey.current_sd**2 * np.outer(here, here)
            w = np.linalg.inv(np.linalg.cholesky(cov))
            turned = slope((Rotation.from_rotvec(WAYS) * rotation).inv().apply(here) @ attitude.T)
            off = [site.sensor.gain_sd * m for m in AXES] + [site.sensor.axis_sd_rad * m for m in pairs]
            model.append(here)
            white.append(w)
            rows.append(w @ np.hstack([gradient, turned]))
            sensor.append(w @ attitude @ np.stack([m @ measured for m in off], axis=1))
        left = [w @ (attitude @ f - m) for w, f, m in zip(white, fields, model, strict=True)]
        return cls(site, attitude, np.ravel(left), np.vstack(rows), np.vstack(sensor), np.array(model), np.array(white))

    def solve(self, also=None, without=None):
        """(cost, unknowns, those of ``also``, covariance of the six) with more columns, or without a beacon."""
        also = np.zeros((len(self.residual), 0)) if also is None else also
        keep = np.ones(len(self.residual))
        if without is not None:
            keep[3 * without : 3 * without + 3] = 0.0
        table = np.hstack([self.rows, also, self.sensor]) * keep[:, None]
        prior = np.hstack([np.zeros((6, 6 + also.shape[1])), np.eye(6)])
        table, right = np.vstack([table, prior]), np.append(self.residual * keep, np.zeros(6))
        size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        inverse = np.linalg.pinv(table / size, rcond=1e-6)
        found = inverse @ right
        covariance = (inverse @ inverse.T) / np.outer(size, size)
        cost = np.sum((right - table / size @ found) ** 2)
        return cost, (found / size)[:6], (found / size)[6 : 6 + also.shape[1]], covariance[:6, :6]

    def takes(self, columns):
        """What more columns, shape (3n, k), would take away of the cost, and their values."""
        cost, _, values, _ = self.solve(columns)
        return self.solve()[0] - cost, values

    def of_beacon(self, i):
        """A column for each whitened component of a beacon."""
        return np.eye(len(self.residual))[:, 3 * i : 3 * i + 3]

    def strength_of(self, i):
        """The column of another strength of a beacon."""
        return self.of_beacon(i) @ (self.whitening[i] @ self.model[i])[:, None]

    def changed(self, matrices):
        """The columns of changes of the sensor."""
        turned = [self.attitude @ m @ self.attitude.T for m in matrices]
        return np.stack([np.einsum("nij,jk,nk->ni", self.whitening, t, self.model).ravel() for t in turned], axis=1)

    def columns_of(self, test):
        """The columns of the test of a name, as ``beacon 2``, ``strength 5``, ``gain``, ``gains``, ``skew``."""
        kind, i = test.split()[0], int(test.split()[-1]) if " " in test else 0
        changes = {"gain": [np.eye(3)], "gains": AXES, "skew": AXES + SKEWS}
        return (
            self.of_beacon(i)
            if kind == "beacon"
            else self.strength_of(i)
            if kind == "strength"
            else self.changed(changes[kind])
        )

    def share(self, test):
        """A test's statistic over its limit: the alarm is raised beyond 1."""
        if test == "whole":
            return self.solve()[0] / chi2.isf(0.1 * FALSE_ALARM, len(self.residual) - 6)
        part, freedom = LIMITS[test.split()[0]]
        return self.takes(self.columns_of(test))[0] / chi2.isf(part * FALSE_ALARM, freedom)

    def shares(self):
        """All of them, by the names of the tests."""
        single = [f"{kind} {i}" for kind in ("beacon", "strength") for i in range(len(self.model))]
        return {test: self.share(test) for test in ("whole", *single, "gain", "gains", "skew")}

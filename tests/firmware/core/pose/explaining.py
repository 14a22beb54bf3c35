"""A board amid the explanation of a wrong pose: its states are put in, and what it makes of them is looked at."""

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.firmware.core.pose.fault_truth import field_T
from tests.firmware.core.pose.test_pose import (
    NOBODY,
    UNEXPLAINED,
    Sensor,
)

SIGMA_T = 2e-8 / np.sqrt(1023)
HOPELESS = 1e30
NO_POSE = 3
SUSPECT, LIKELY = 0.01, 1e-5


class Place:
    """A pose at a site with its fields, shape (n, 3), T."""

    def __init__(self, site, position, rotation):
        self.site, self.position, self.rotation = site, np.asarray(position), rotation
        self.fields = rotation.inv().apply(np.array([field_T(b, self.position) for b in site.beacons]))


class Explaining:
    """A board amid an explanation; the beacons of the rows are heard."""

    def __init__(self, core, place, fields=None, rows=None):
        self.ffi, self.lib = core
        self.place, self.sensor = place, Sensor(core, place.site)
        fields = place.fields if fields is None else fields
        heard = range(len(fields)) if rows is None else rows
        table = [(f.tolist(), SIGMA_T if i in heard else 0.0) for i, f in enumerate(fields)]
        self.ffi.memmove(self.sensor.work, b"\x55" * 64, 64)
        self.solver = self.ffi.addressof(self.sensor.work, "solver")
        self.explain = self.ffi.addressof(self.sensor.work, "explain")
        self.problem = self.ffi.addressof(self.solver, "problem")
        self.pose = self.ffi.new("pose_t *")
        self.pose.left_out = NOBODY
        self.lib.pose_problem(self.sensor.site, self.ffi.new("pose_field_t[]", table), self.problem)
        self.solver.stage = self.lib.POSE_SOLVE_DONE
        self.explain.next_cost = HOPELESS
        self.explain.rest.cost = HOPELESS
        self.explain.whole = UNEXPLAINED
        self.explain.total = [1.0, 1.0, 1.0]

    def start(self, fit, offset_m=(0.0, 0.0, 0.0)):
        """Put the true pose, so far off, into a fit."""
        fit.position_m = (self.place.position + offset_m - np.array(list(self.problem.origin_m))).tolist()
        fit.quaternion = self.place.rotation.as_quat().tolist()
        return fit

    def fitted(self, without=None):
        """A fit of the fields of all beacons, or of all but one."""
        fit = self.start(self.ffi.new("pose_fit_t *"))
        if without is not None:
            self.lib.pose_problem_leave_out(self.problem, without, True)
        self.lib.pose_fit(self.problem, 30, fit)
        if without is not None:
            self.lib.pose_problem_leave_out(self.problem, without, False)
        return fit[0]

    def evaluated(self, offset_m=(0.0, 0.0, 0.0)):
        """The true pose, so far off, as it is."""
        fit = self.start(self.ffi.new("pose_fit_t *"), offset_m)
        self.lib.pose_fit(self.problem, 1, fit)
        return fit[0]

    def step(self, stage):
        """Do the step of a stage; returns whether the explanation is complete."""
        self.explain.stage = stage
        return bool(self.lib.pose_explain_step(self.solver, self.explain, self.pose))

    def fields_T(self):
        """The fields that the problem has now, by the rows of the site."""
        rows = sorted((h.row, list(h.field_uT)) for h in list(self.problem.heard)[: self.problem.count])
        return 1e-6 * np.array([field for _, field in rows])

    def order(self):
        """The rows of the beacons that are heard, and that of the one behind them."""
        rows = [self.problem.heard[i].row for i in range(self.problem.count + 1)]
        return rows[:-1], rows[-1]

    def searches(self, directions, evaluations):
        """Whether such a search has been begun."""
        asked = (self.solver.candidates.directions, self.solver.left, self.solver.candidates.next)
        return self.solver.stage == self.lib.POSE_SOLVE_SEARCH and asked == (directions, evaluations, 0)

    def answer(self):
        return self.pose.status, self.pose.reason, self.pose.left_out


def same(fields, expected):
    return np.allclose(fields, expected, rtol=1e-6, atol=0.0)


def off(place, share, freedom, rows, seed=3):
    """The fields with a residual that no pose takes away of those rows, so far from the chi-square of one in 100."""
    rng, eps = np.random.default_rng(seed), 1e-5
    columns = []
    for way in eps * np.eye(6):
        turn = Rotation.from_rotvec(way[3:]) * place.rotation
        moved = Place(place.site, place.position + way[:3], turn).fields
        columns.append((moved - place.fields)[rows].ravel() / eps)
    known = np.linalg.qr(np.array(columns).T)[0]
    left = rng.normal(size=3 * len(rows))
    for _ in range(2):
        left -= known @ (known.T @ left)
    left *= np.sqrt(share * chi2.isf(SUSPECT, freedom)) / np.linalg.norm(left)
    fields = place.fields.copy()
    fields[rows] += SIGMA_T * left.reshape(-1, 3)
    return fields

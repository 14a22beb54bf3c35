"""Least squares of many problems at once: where each ends, by what, and what it took."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from goldfield.locate.least_squares import minimise


class Problems:
    """Residuals of problems by a function of the unknowns and the problem; counts what is evaluated."""

    def __init__(self, misfit, slope):
        self._misfit, self._slope, self.rows = misfit, slope, []

    def __call__(self, state, rows):
        self.rows.append(rows.tolist())
        residual = np.array([self._misfit(x, e) for x, e in zip(state[0], rows, strict=True)])
        jacobian = np.array([self._slope(x, e).T for x, e in zip(state[0], rows, strict=True)])
        return residual, jacobian


def move(state, step):
    return (state[0] + step,)


def linear(seed=1, count=4):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(count, 9, 3)), rng.normal(size=(count, 9))
    return a, b, Problems(lambda x, e: b[e] - a[e] @ x, lambda _, e: a[e])


def test_linear_problems_end_at_the_solution_with_their_normal_matrix():
    a, b, problems = linear()
    start = np.full((4, 3), 10.0)
    end = minimise(problems, move, (start,))
    assert (start == 10.0).all()
    for e in range(4):
        solution, cost, *_ = np.linalg.lstsq(a[e], b[e])
        np.testing.assert_allclose(end.state[0][e], solution, atol=1e-5)
        assert end.cost[e] == pytest.approx(cost[0], abs=1e-6)
        np.testing.assert_allclose(end.normal[e], a[e].T @ a[e], rtol=1e-12)
    assert end.converged.all()
    assert end.evaluations == sum(map(len, problems.rows))
    assert end.evaluations <= 4 * 5


def test_a_curved_valley_ends_where_scipys_search_does():
    problems = Problems(
        lambda x, _: -np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        lambda x, _: np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]),
    )
    start = np.array([[-1.2, 1.0], [3.0, -2.0]])
    end = minimise(problems, move, (start,))
    assert end.converged.all()
    for e in range(2):
        theirs = least_squares(lambda x: [10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]], start[e], xtol=1e-12)
        np.testing.assert_allclose(end.state[0][e], theirs.x, atol=1e-3)
        assert end.cost[e] < 1e-6
    assert end.evaluations == sum(map(len, problems.rows))
    assert end.evaluations < 2 * 40


@pytest.mark.parametrize("iterations", [0, 1, 2])
def test_no_more_than_the_iterations_are_made(iterations):
    _, _, problems = linear()
    start = np.full((4, 3), 1e3)
    end = minimise(problems, move, (start,), iterations=iterations, tolerance=0.0)
    assert problems.rows == [[0, 1, 2, 3]] * (1 + iterations)
    assert end.evaluations == 4 * (1 + iterations)
    assert not end.converged.any()
    assert (end.state[0] == start).all() == (iterations == 0)


def test_a_problem_that_has_ended_is_not_evaluated_again():
    a, b, problems = linear()
    start = np.full((4, 3), 1e6)
    start[2] = np.linalg.lstsq(a[2], b[2])[0]
    minimise(problems, move, (start,))
    assert problems.rows[:3] == [[0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 3]]


@pytest.mark.parametrize(("share", "ended"), [(0.99, True), (1.01, False)])
def test_a_problem_ends_by_what_its_next_step_promises(share, ended):
    """A residual of x promises to lose its square, but for a thousandth that the damping keeps."""
    problems = Problems(lambda x, _: -x, lambda *_: np.eye(1))
    minimise(problems, move, (np.array([[np.sqrt(share * 1e-4 * 1.001)]]),), tolerance=1e-4)
    assert len(problems.rows) == (2 if ended else 3)


def test_a_hopeless_start_ends_at_once_and_leaves_the_others_alone():
    a, b, problems = linear()
    start = np.full((4, 3), 10.0)
    start[1] = np.nan
    end = minimise(problems, move, (start,))
    assert end.converged.tolist() == [True, False, True, True]
    assert np.isnan(end.state[0][1]).all()
    assert not np.isfinite(end.cost[1])
    assert all(1 not in rows for rows in problems.rows[1:])
    np.testing.assert_allclose(end.state[0][3], np.linalg.lstsq(a[3], b[3])[0], atol=1e-5)


def test_what_nothing_tells_stays_where_it_was():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(6, 2)), rng.normal(size=6)
    problems = Problems(lambda x, _: b - a @ x[:2], lambda *_: np.hstack([a, np.zeros((6, 1))]))
    end = minimise(problems, move, (np.array([[5.0, -5.0, 7.0]]),))
    np.testing.assert_allclose(end.state[0][0], [*np.linalg.lstsq(a, b)[0], 7.0], atol=1e-5)
    assert end.converged.all()


def test_a_problem_that_no_step_improves_ends_stuck():
    """Its slope is of the wrong sign; each trial is shorter, until the step is a part in a million million."""
    problems = Problems(lambda x, _: x, lambda *_: np.eye(1))
    end = minimise(problems, move, (np.array([[1.0]]),), tolerance=0.0)
    assert end.state[0].tolist() == [[1.0]]
    assert not end.converged.any()
    assert 10 < end.evaluations < 30


def test_units_of_the_unknowns_do_not_matter():
    def took(unit):
        problems = Problems(
            lambda x, _: -np.array([10.0 * (x[1] / unit - x[0] ** 2), 1.0 - x[0]]),
            lambda x, _: np.array([[-20.0 * x[0], 10.0 / unit], [-1.0, 0.0]]),
        )
        return minimise(problems, move, (np.array([[-1.2, unit]]),)).evaluations

    assert took(1.0) == took(1e-3) == took(1e3)

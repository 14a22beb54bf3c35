"""One map whoever computes it: this process, processes, Dask workers; and the points of the grid."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from distributed import LocalCluster

from goldfield.errors import SystemFailure, UserError
from goldfield.planning import Grid, Request, plan
from goldfield.planning.grid import TILE_POINTS
from tests.host.planning.built import ceiling


@pytest.fixture(scope="module")
def request_of_a_hall():
    return Request(ceiling(6, 5), Grid.of_box(np.array([0.0, 0.0, 0.5]), np.array([15.0, 12.0, 2.0]), 0.75))


@pytest.fixture(scope="module")
def here(request_of_a_hall):
    return plan(request_of_a_hall)


def assert_same(first, second):
    for part in fields(first.figures):
        one, other = getattr(first.figures, part.name), getattr(second.figures, part.name)
        if one.dtype.kind == "f":
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=0.0, err_msg=part.name)
        else:
            np.testing.assert_array_equal(one, other, err_msg=part.name)
    np.testing.assert_array_equal(first.conflicts.pair, second.conflicts.pair)
    np.testing.assert_allclose(first.conflicts.level_dB, second.conflicts.level_dB, rtol=1e-12)
    np.testing.assert_array_equal(first.shared_code, second.shared_code)


def test_two_processes_make_the_same_map(request_of_a_hall, here):
    done = []
    assert_same(here, plan(request_of_a_hall, workers=2, progress=done.append))
    assert sum(done) == len(request_of_a_hall.grid)


def test_two_dask_workers_make_the_same_map(request_of_a_hall, here):
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        assert_same(here, plan(request_of_a_hall, scheduler=cluster.scheduler_address))


def test_a_scheduler_without_workers_is_told(request_of_a_hall):
    with (
        LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        pytest.raises(SystemFailure, match="has no workers: start some with 'dask worker tcp://"),
    ):
        plan(request_of_a_hall, scheduler=cluster.scheduler_address)


@pytest.mark.parametrize("address", ["nonsense://x", "tcp://127.0.0.1:1"])
def test_a_scheduler_that_is_not_there_is_told(request_of_a_hall, address, monkeypatch):
    monkeypatch.setattr("goldfield.planning.spreading.CONNECT_S", 0.5)
    with pytest.raises(SystemFailure, match="no Dask scheduler answers at scheduler="):
        plan(request_of_a_hall, scheduler=address)


def test_a_map_does_not_depend_on_how_the_grid_is_divided(request_of_a_hall, here):
    """A point's figures are those of a plan of this point alone, but for the beacons that are left out."""
    grid = request_of_a_hall.grid
    place = np.array([grid.x_m[7], grid.y_m[3], grid.z_m[1]])
    (alone,) = plan(Request(request_of_a_hall.site, Grid.of_box(place, place, 1.0))).figures.position_sd_m.ravel()
    assert here.figures.position_sd_m[7, 3, 1] == pytest.approx(alone, rel=0.011)


@pytest.mark.parametrize("shape", [(1, 1, 1), (7, 1, 3), (40, 33, 5), (300, 1, 1)])
def test_tiles_cover_each_point_once(shape):
    grid = Grid.of_box(np.zeros(3), np.array(shape) - 1.0, 1.0)
    assert grid.shape == shape
    times = np.zeros(shape, dtype=int)
    for tile in grid.tiles():
        times[tile] += 1
        x, y, z = np.meshgrid(grid.x_m[tile[0]], grid.y_m[tile[1]], grid.z_m[tile[2]], indexing="ij")
        assert (grid.points(tile) == np.column_stack([x.ravel(), y.ravel(), z.ravel()])).all()
        assert len(grid.points(tile)) <= 2 * TILE_POINTS
    assert (times == 1).all()


def test_grids_that_make_no_sense_are_refused():
    with pytest.raises(UserError, match="second corner below its first in y"):
        Grid.of_box(np.zeros(3), np.array([1.0, -1.0, 1.0]), 0.5)
    with pytest.raises(UserError, match=r"step=0.001 makes 1e\+09 points"):
        Grid.of_box(np.zeros(3), np.ones(3), 0.001)


def test_a_box_ends_at_its_last_whole_step():
    grid = Grid.of_box(np.zeros(3), np.array([1.0, 0.99, 0.3]), 0.1)
    assert grid.shape == (11, 10, 4)

"""One map whoever computes it: this process, processes, Dask workers; and the points of the grid."""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys
import tracemalloc
from dataclasses import fields

import numpy as np
import pytest
from distributed import Client, LocalCluster

from goldfield.errors import SystemFailure, UserError
from goldfield.planning import Grid, Request, plan
from goldfield.planning.grid import TILE_POINTS
from goldfield.planning.maps import Figures
from goldfield.planning.tile import TileResult
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


FAULTS_A_POINT = 20
"""Pages that the system has to clear for a point: a few where memory is kept, more than a hundred where it is not."""


def faults() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt


def print_faults_a_point() -> None:
    """Print the faults a point of a plan that is made for the second time in this process."""
    request = Request(ceiling(6, 5), Grid.of_box(np.array([0.0, 0.0, 0.5]), np.array([15.0, 12.0, 2.0]), 0.75))
    plan(request)
    before = faults()
    plan(request)
    print((faults() - before) / len(request.grid))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries are left as they are")
def test_freed_memory_is_not_fetched_again_for_each_array():
    code = "from tests.host.planning.test_spreading import print_faults_a_point; print_faults_a_point()"
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}  # as a Dask worker's nanny sets it
    ended = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert float(ended.stdout) < FAULTS_A_POINT


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries are left as they are")
def test_a_dask_worker_does_not_fetch_freed_memory_again(request_of_a_hall):
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        plan(request_of_a_hall, scheduler=cluster.scheduler_address)
        (before,) = client.run(faults).values()
        plan(request_of_a_hall, scheduler=cluster.scheduler_address)
        (after,) = client.run(faults).values()
    assert (after - before) / len(request_of_a_hall.grid) < FAULTS_A_POINT


def test_the_memory_of_a_plan_does_not_grow_with_its_tiles(monkeypatch):
    """All tiles have the same conflicts between the same beacons: what is held beside the maps stays as it is."""
    site, held = ceiling(6, 5), []

    def compute_tile(request, tile):
        pairs = {(i, j): 0.1 + 1e-6 * j for i in range(30) for j in range(30) if i != j}
        return TileResult(tile, Figures.empty((len(request.grid.points(tile)),), request.settings.best), pairs)

    monkeypatch.setattr("goldfield.planning.spreading.compute_tile", compute_tile)
    for metres in (16.0, 64.0):
        grid = Grid.of_box(np.zeros(3), np.array([metres, metres, 0.0]), 0.5)
        tracemalloc.start()
        maps = plan(Request(site, grid))
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        held.append(most - sum(getattr(maps.figures, part.name).nbytes for part in fields(maps.figures)))
    assert held[1] < 1.5 * held[0]


def test_a_scheduler_without_workers_is_told(request_of_a_hall):
    with (
        LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        pytest.raises(SystemFailure, match="has no workers: start some with 'dask worker tcp://"),
    ):
        plan(request_of_a_hall, scheduler=cluster.scheduler_address)


NO_SCHEDULER = [
    "nonsense://x",
    "nonsense",
    "",
    "tcp://x",
    "tcp://127.0.0.1:1",
    "tcp://127.0.0.1:99999",
    "tls://127.0.0.1:1",
]


@pytest.mark.filterwarnings("error")  # what a client that is half made would say of itself
@pytest.mark.parametrize("address", NO_SCHEDULER)
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

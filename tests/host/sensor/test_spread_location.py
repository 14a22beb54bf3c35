"""A long table of fields, located by two processes and by two Dask workers: the poses of one after the other."""

from __future__ import annotations

import numpy as np
import pytest
from distributed import LocalCluster

from goldfield.cli import main
from goldfield.locate import locate
from goldfield.sensor import spread_location
from goldfield.sensor.fields_table import FieldsWriter
from goldfield.sensor.location import location
from goldfield.sensor.options import Method
from goldfield.sensor.spread_location import BATCH, spread_poses
from tests.bench.integrity_coils import Coils
from tests.bench.integrity_sites import EXACT, text_of
from tests.bench.survey_trials import cube, fields_of, measured, walk

SITE = cube(2e-7).site
NAMES = tuple(beacon.id for beacon in SITE.beacons)


@pytest.fixture(scope="module")
def epochs():
    """A slow walk, and a coil that is moved by 10 cm in the middle: from then on the history names it."""
    rng = np.random.default_rng(3)
    count = 2 * BATCH + 50
    position, rotation = walk(cube(), rng, 20 * count)
    position, rotation = position[:count], rotation[:count]
    coils = Coils.of(SITE, 1)
    off = np.zeros(coils.position_m.shape)
    off[0, 2, 0] = 0.1
    sigma = 2e-7 / np.sqrt(1023)
    before, after = (measured(one, position, rotation, np.eye(3), sigma, rng) for one in (coils, coils.moved(off)))
    half = np.arange(count)[:, None, None] < count // 2
    return fields_of(NAMES, np.where(half, before, after), sigma)


@pytest.fixture(scope="module")
def here(epochs):
    locate = location(SITE, Method.EACH)
    return [locate(fields, None) for fields in epochs]


def assert_same(one, other):
    assert len(one) == len(other)
    for first, second in zip(one, other, strict=True):
        assert (first.epoch, first.status, first.excluded) == (second.epoch, second.status, second.excluded)
        assert (first.reason, first.used) == (second.reason, second.used)
        for name in ("position_m", "orientation_xyzw", "position_cov_m2"):
            np.testing.assert_allclose(getattr(first, name), getattr(second, name), rtol=1e-12, atol=0.0)


def test_the_history_matters_here(here):
    """Else the pieces would be the same by chance."""
    named = [bool(pose.findings) for pose in here]
    assert not any(named[: len(named) // 2])
    assert sum(named) > BATCH // 2


def test_two_processes_make_the_same_poses(epochs, here):
    assert_same(here, list(spread_poses(SITE, iter(epochs), workers=2)))


def test_two_dask_workers_make_the_same_poses(epochs, here):
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        assert_same(here, list(spread_poses(SITE, iter(epochs), scheduler=cluster.scheduler_address)))


def test_an_epoch_that_a_worker_cannot_locate_is_located_here(epochs, here, monkeypatch):
    def broken(site, fields):
        if fields.epoch == 3:
            raise RuntimeError("a defect")
        return locate(site, fields)

    monkeypatch.setattr(spread_location, "locate", broken)
    assert_same(here[:8], list(spread_poses(SITE, epochs[:8])))


def test_the_command_prints_the_same_lines(epochs, tmp_path, capsys):
    (tmp_path / "site.toml").write_text(text_of(SITE, EXACT))
    with FieldsWriter(tmp_path / "fields.csv") as table:
        for fields in epochs[: BATCH + 20]:
            table.write(fields)
    words = ["locate", "--site", str(tmp_path / "site.toml"), str(tmp_path / "fields.csv"), "--json"]
    assert main(words) == 0
    alone = capsys.readouterr().out
    assert main([*words, "--workers", "2"]) == 0
    assert capsys.readouterr().out == alone
    assert main([*words, "--workers", "2", "--track"]) == 0
    assert "--workers has no effect with --track" in capsys.readouterr().err

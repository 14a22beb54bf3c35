"""A walk on a simulated bench: the epochs of the table of known points are those of the fields."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.locate import locate
from hil_sim import scenario
from hil_sim.bench import SimulatedBench
from hil_sim.rig import point_row

KNOWN_M = [0.9, 1.3, 0.7]


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """Return a bench that walks to one known point within seconds, its fields by epoch, and the rows of the table."""
    text = scenario.find("walk8").read_text()
    head, rest = text.split("[[known_point]]", 1)
    head = head.replace("seconds = 60.0 ", "seconds = 0.5\nstart_s = 2.5 ")
    point = f"[[known_point]]\nposition_m = {KNOWN_M}\nsigma_m = 0.002\ncycles = 10\n\n"
    exact = "[coil]" + rest.split("[coil]", 1)[1]
    directory = tmp_path_factory.mktemp("walk")
    path = directory / "bench.toml"
    path.write_text(head + point + exact)
    bench = SimulatedBench(str(path), "host", directory)
    try:
        fields = {one.epoch: one for one in bench.fields(110)}
        rows = [row for truth in bench.truth().values() if (row := point_row(bench.scenario, truth))]
        yield bench, fields, [list(map(float, row.split(","))) for row in rows]
    finally:
        bench.close()


def test_at_these_epochs_the_sensor_is_there(walked):
    bench, fields, rows = walked
    assert 10 <= len(rows) <= 11
    away = []
    for epoch, *place, sigma in rows:
        assert place == KNOWN_M
        assert sigma == 0.002
        away.append(np.linalg.norm(locate(bench.site, fields[int(epoch)]).position_m - KNOWN_M))
    assert np.median(away) < 0.02  # the noise of a cycle is 7 mm here


def test_at_others_it_is_elsewhere(walked):
    bench, fields, rows = walked
    at_it = {int(row[0]) for row in rows}
    first, last = min(at_it), max(at_it)
    before = [locate(bench.site, fields[epoch]).position_m for epoch in range(first - 12, first - 8)]
    assert all(np.linalg.norm(place - KNOWN_M) > 0.05 for place in before)
    assert at_it == set(range(first, last + 1))

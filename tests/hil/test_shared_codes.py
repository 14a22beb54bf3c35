"""Beacons that share a code, far from each other: a sensor near one and near the other, and on its way between them."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from goldfield import site as sites
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Epoch, Sensor
from goldfield.types import Status
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import Scenario, load_scenario, site_toml
from tests.hil.rig_link import RigSerialLink

COLUMNS = 7
LENGTH_M = 2.0 * (COLUMNS - 1)
SHARED = {13: 2, 14: 3}
"""By beacon: the beacon whose code it has too. The first stand at x = 0 and 2 m, these at 12 m."""
MOTION = f"""[motion]
kind = "waypoints"
times_s = [0.0, 4.0, 14.0, 20.0]
positions_m = [[1.0, 0.7, 0.8], [1.0, 0.7, 0.8], [{LENGTH_M - 1.0}, 1.3, 1.0], [{LENGTH_M - 1.0}, 1.3, 1.0]]
rotation_vectors_rad = [[0.3, -0.2, 1.1], [0.3, -0.2, 1.1], [0.3, -0.2, 1.5], [0.3, -0.2, 1.5]]

"""
WRONG = chi2.ppf(1.0 - 1e-5, 3)


def corridor() -> str:
    """Return a scenario: beacons on both sides of a corridor, every 2 m, by turns on the floor and at the ceiling."""
    text = (ROOT / "hil_sim/scenarios/prigge8.toml").read_text(encoding="utf-8")
    text = text[: text.index("[[beacon]]")].replace("noise_T = 2.0e-7", "noise_T = 5.0e-8")
    text = text.replace("pose = 1 ", "pose = 0 ").replace("seed =", "shared_codes = true\nseed =", 1)
    text = text[: text.index("[motion]")] + MOTION + text[text.index("[coil]") :]
    for i in range(2 * COLUMNS):
        x, y, z = 2.0 * (i // 2), 2.0 * (i % 2), 1.8 * ((i // 2 + i) % 2)
        code = SHARED.get(i + 1, i + 1) + 1
        text += f'[[beacon]]\nid = "b{i + 1}"\nnode = {i + 1}\nposition_m = [{x}, {y}, {z}]\ncode = {code}\n'
        text += f"crystal_ppm = {(-1) ** i * 2.0 * i}\n" + ("sync_master = true\n\n" if i == 0 else "\n")
    return text


def walk(directory: Path, monkeypatch: pytest.MonkeyPatch, strongest: int) -> tuple[list[Epoch], Rig, Scenario]:
    """Return the epochs of a whole walk."""
    path = directory / "shared.toml"
    path.write_text(corridor(), encoding="utf-8")
    scenario = load_scenario(str(path))
    (directory / "site.toml").write_text(site_toml(scenario), encoding="utf-8")
    rig = Rig(scenario, "host")
    rig.advance(2.5)
    link = RigSerialLink(rig)
    for module in (sessions, dialogues):
        monkeypatch.setattr(module, "time", link)
    with Sensor(link, "rig", sites.load(directory / "site.toml"), Options(strongest=strongest)) as sensor:
        return list(itertools.islice(sensor.epochs(), 135)), rig, scenario


@pytest.mark.parametrize("strongest", [6, 16])
def test_a_walk_from_a_beacon_to_the_one_that_has_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, strongest: int
) -> None:
    """Near either end its beacons are used, and no pose is wrong.

    With 6 codes it is never the further one of two. With 16 all are reported everywhere, against the rule that a code
    is shared only where the other's field is far weaker: between the two its field may be taken for the further one's.
    """
    epochs, rig, scenario = walk(tmp_path, monkeypatch, strongest)
    truth = {one.cycle: one.position_m for one in rig.truth()}
    rig.close()
    shared = {code + 1 for code in SHARED.values()}
    at_first, at_last, between = [], [], []
    for epoch in epochs:
        pose = epoch.pose
        if pose.epoch not in truth:
            continue
        x = truth[pose.epoch][0]
        (at_first if x < 1.5 else at_last if x > LENGTH_M - 1.5 else between).append(epoch)
        if pose.status in (Status.OK, Status.UNVERIFIED):
            off = pose.position_m - truth[pose.epoch]
            assert off @ np.linalg.solve(pose.position_cov_m2, off) < WRONG
        for far, near in itertools.chain(SHARED.items(), map(reversed, SHARED.items())):
            places = [scenario.beacons[beacon - 1].geometry.position_m for beacon in (far, near)]
            away = [float(np.linalg.norm(place - truth[pose.epoch])) for place in places]
            assert f"b{far}" not in epoch.fields.beacons or away[0] < away[1] or strongest > 6
    for there, beacons in ((at_first, {"b2", "b3"}), (at_last, {"b13", "b14"})):
        assert len(there) >= 12
        assert all(shared <= set(epoch.report.correlation_T) for epoch in there)
        assert all(beacons <= set(epoch.fields.beacons) for epoch in there)
        assert np.mean([epoch.pose.status is Status.OK for epoch in there]) > 0.9
    assert np.mean([epoch.pose.status in (Status.OK, Status.UNVERIFIED) for epoch in between]) > 0.8

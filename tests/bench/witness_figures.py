"""Print how often sound beacons are named: ``python -m tests.bench.witness_figures [--hours H] [--minutes M]``.

H hours of epochs with the noise of the separated fields, coils by magpylib and the sensor on a circle, go through the
history of the residuals; M virtual minutes of host boards go through the whole host, anchors among them. The permitted
rate is too small to be counted: the same epochs go through histories that are permitted to name beacons more often, and
what they do of what they may tells what is to be expected.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from unittest import mock

import magpylib
import numpy as np

from goldfield import site as sites
from goldfield.locate import Locator
from goldfield.sensor import dialogue, session
from goldfield.sensor.location import UNKNOWN_MOTION, location
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Sensor
from goldfield.track import EpochObserver, Witness, witness
from goldfield.track.estimate import Belief
from goldfield.track.faults import judged
from goldfield.track.motion import RATE, standing
from goldfield.types import Explanation, Fields
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, circling
from tests.command import real_number, whole_number
from tests.hil.rig_link import RigLink

CHIPS = 1023
PERMITTED_AN_HOUR = (1000.0, 300.0, 100.0, 30.0, 10.0)
TURN_S = 60.0
"""The sensor takes another circle after so long."""


def bound(alarms: int, hours: float) -> str:
    """Return the 95 % upper limit of the rate, in words."""
    from scipy.stats import chi2

    return f"at most {chi2.ppf(0.95, 2 * alarms + 2) / 2.0 / hours:.2g} an hour with 95 % confidence"


def of_history(hours: float, noise_T: float, seed: int) -> None:
    """Print how often the history of the residuals names a beacon in so many hours of sound epochs."""
    site = prigge_cube(noise_T)
    names, sigma_T = tuple(b.id for b in site.beacons), noise_T / np.sqrt(CHIPS)
    coils, rng = Room(site).coils, np.random.default_rng(seed)
    step, epochs, alarms, out = location(site, Method.EACH), round(hours * 3600.0 / site.cycle_s), 0, 0
    batch = round(TURN_S / site.cycle_s)
    before: tuple[str, ...] = ()
    for first in range(0, epochs, batch):
        position, rotation = circling(rng, 0.5, 0.5).poses(np.arange(batch) * site.cycle_s)
        exact = magpylib.getB(coils, position, squeeze=False)[:, 0, 0]  # (n, t, 3)
        for k in range(batch):
            field_T = rotation[k].inv().apply(exact[:, k]) + sigma_T * rng.normal(size=(len(names), 3))
            pose = step(
                Fields(first + k, (first + k) * site.cycle_s, names, field_T, np.full(len(names), sigma_T)), None
            )
            found = tuple(name for finding in pose.findings for name in finding.beacons)
            alarms, out, before = alarms + bool(set(found) - set(before)), out + bool(pose.excluded), found
    print(
        f"history, {noise_T * 1e7:g} mG: {alarms} names in {epochs} epochs ({hours:g} h): {bound(alarms, hours)}; "
        f"{out} poses without a beacon"
    )


def by_permitted_rate(hours: float, noise_T: float, seed: int) -> None:
    """Print how often histories name a sound beacon beside how often they are permitted to."""
    site = prigge_cube(noise_T)
    names, sigma_T = tuple(b.id for b in site.beacons), np.full(len(site.beacons), noise_T / np.sqrt(CHIPS))
    locator, observer = Locator(site), EpochObserver(site)
    coils, rng = Room(site).coils, np.random.default_rng([seed, 1])
    watching = {}
    for rate in PERMITTED_AN_HOUR:
        with mock.patch.object(witness, "FALSE_ALARMS_PER_HOUR", rate):
            watching[rate] = Witness(site)
    named = dict.fromkeys(watching, 0)
    before: dict[float, tuple[str, ...]] = dict.fromkeys(watching, ())
    batch = round(TURN_S / site.cycle_s)
    for first in range(0, round(hours * 3600.0 / site.cycle_s), batch):
        position, rotation = circling(rng, 0.5, 0.5).poses(np.arange(batch) * site.cycle_s)
        exact = magpylib.getB(coils, position, squeeze=False)[:, 0, 0]  # (n, t, 3)
        seen = [rotation[k].inv().apply(exact[:, k]) for k in range(batch)]
        epochs = [
            Fields(
                first + k,
                (first + k) * site.cycle_s,
                names,
                one + sigma_T[:, None] * rng.normal(size=one.shape),
                sigma_T,
            )
            for k, one in enumerate(seen)
        ]
        for fields, pose in zip(epochs, locator.locate_many(epochs), strict=True):
            if pose.findings or pose.excluded:
                continue
            state = standing(pose.position_m, pose.orientation_xyzw)
            observation, _ = observer.observation(fields, UNKNOWN_MOTION[RATE].max())
            judgement = judged(observation, state, Belief(state, np.diag(UNKNOWN_MOTION)))
            for rate, one in watching.items():
                one.update(judgement)
                named[rate] += one.named not in ((), before[rate])
                before[rate] = one.named
    found = ", ".join(f"{count / hours:.3g} of {rate:g}" for rate, count in named.items())
    print(f"history, {noise_T * 1e7:g} mG, {hours:g} h: names an hour of those permitted: {found}")


def of_boards(name: str, minutes: float, seed: int) -> None:
    """Print how often anything names a beacon in so many virtual minutes of sound host boards."""
    scenario = load_scenario(name)
    with tempfile.TemporaryDirectory() as directory:
        site_file = Path(directory) / "site.toml"
        site_file.write_text(site_toml(scenario))
        site = sites.load(site_file)
    with Rig(scenario, "host", seed) as rig:
        rig.advance(2.5)
        link = RigLink(rig)
        with mock.patch.object(session, "time", link), mock.patch.object(dialogue, "time", link):
            sensor = Sensor(link, name, site, Options(node=scenario.sensor.node))
            epochs, count, named = sensor.epochs(), 0, 0
            while rig.now_s < 2.5 + 60.0 * minutes:
                pose = next(epochs).pose
                count += 1
                named += any(finding.kind is not Explanation.BOARD for finding in pose.findings)
    print(
        f"{name}, host boards: {named} of {count} sound epochs name a beacon ({minutes:g} min): "
        f"{bound(named, minutes / 60.0)}"
    )


def main(argv: list[str] | None = None) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--hours", type=real_number(0.001), default=1.0, help="hours of epochs through the history (default 1)"
    )
    parser.add_argument(
        "--minutes", type=real_number(0.1), default=5.0, help="virtual minutes of each bench (default 5)"
    )
    parser.add_argument("--seed", type=whole_number(), default=11)
    options = parser.parse_args(argv)
    for noise_T in (2e-7, 2e-8):
        of_history(options.hours, noise_T, options.seed)
        by_permitted_rate(options.hours, noise_T, options.seed)
    for name in ("prigge8", "anchors4"):
        of_boards(name, options.minutes, options.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())

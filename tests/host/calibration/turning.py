"""Recordings of a turned sensor, of the simulator's world alone: magpylib's coils, a hand's motion, no host model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield import site as sites
from goldfield.calibration.turn import Turn
from hil_sim import scenario
from hil_sim.world.walk import Limits, turning

EARTH_T = np.array([2.0e-5, 0.0, -4.5e-5])
PLACE_M = np.array([0.9, 1.2, 0.8])
MOMENTS, MOMENT_WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass
class Recording:
    """A site file as read by the host, what the sensor read, and the truth."""

    site: object
    turn: Turn
    axes: np.ndarray
    offset_T: np.ndarray


def record(
    directory,
    seed,
    *,
    cycles=150,
    noise_T=2e-8,
    installation="",
    rate_rad_per_s=1.0,
    motion=None,
    sway_m=0.01,
    constant_T=0.0,
):
    """Record cycles of 0.1 s on the bench prigge8 with errors of installation; noise is that of a chip's sample.

    ``constant_T`` is the deviation of what is added to each beacon's field in the room all the time, as by the mains.

    Each axis of the sensor has a gain and a direction that are off by a percent, and an offset of a microtesla.
    """
    random = np.random.default_rng([seed, 99])
    text = scenario.find("prigge8").read_text().replace("noise_T = 2.0e-7", f"noise_T = {noise_T}")
    file = directory / "bench.toml"
    file.write_text(text.replace("seed = 1\n", f"seed = {seed}\n", 1) + f"\n[installation]\n{installation}\n")
    bench = scenario.load(file)
    site_file = directory / "site.toml"
    site_file.write_text(scenario.site_toml(bench))
    site = sites.load(site_file)
    axes = np.eye(3)
    axes[np.triu_indices(3)] += 0.01 * random.normal(size=6)
    offset_T = 1e-6 * random.normal(size=3)
    if motion is None:
        motion = turning(seed, 0.0, cycles * site.cycle_s, PLACE_M, sway_m, Limits(np.inf, rate_rad_per_s))
    middle_s = (np.arange(cycles) + 0.5) * site.cycle_s
    times_s = middle_s[:, None] + 0.5 * site.cycle_s * MOMENTS
    positions, rotations = motion.poses(times_s.ravel())
    coils = [
        (beacon.geometry, beacon.circuit.current_A / (1.0 + beacon.circuit.sense_gain_error))
        for beacon in bench.installed.beacons
    ]
    fields = [current_A * coil.field_per_ampere(positions) for coil, current_A in coils]
    fields = [field + constant_T * random.normal(size=3) for field in fields]
    fields.append(np.tile(EARTH_T, (len(positions), 1)))
    seen = np.stack([rotations.inv().apply(field) @ axes.T for field in fields], axis=1)
    means = np.einsum("kmnc,m->knc", seen.reshape(cycles, len(MOMENTS), -1, 3), 0.5 * MOMENT_WEIGHTS)
    sigma_T = site.sensor.noise_T / np.sqrt(site.chips)
    means += sigma_T * random.normal(size=means.shape)
    turn = Turn(
        epoch=np.arange(cycles),
        time_s=middle_s,
        field_T=means[:, :-1],
        sigma_T=np.full((cycles, len(coils)), sigma_T),
        mean_T=means[:, -1] + offset_T,
        mean_sigma_T=sigma_T,
        cycle_s=site.cycle_s,
    )
    return Recording(site, turn, axes, offset_T)

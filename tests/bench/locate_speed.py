"""Location by `scipy.optimize.least_squares` with our steps and starts, a walk, and how long hard epochs take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from goldfield.locate.starts import simple_magnitudes
from goldfield.locate.wahba import wahba
from goldfield.types import Fields
from tests.bench import locate_trials as bench
from tests.bench.integrity_outcome import times_s


def with_scipy(model, epoch):
    """Locate an epoch by our steps with SciPy's optimiser; the position."""
    magnitude = np.linalg.norm(epoch.field_T, axis=1)
    known = np.ones((1, len(model)), dtype=bool)
    position = simple_magnitudes(model, magnitude[None], epoch.sigma_T[None], known)[0]

    def of_logarithms(p):
        error = np.log(magnitude) - np.log(np.linalg.norm(model.field(p), axis=1))
        return error / np.hypot(0.1, epoch.sigma_T / magnitude)

    position = least_squares(of_logarithms, position).x
    rotation = wahba(model.field(position), epoch.field_T, 1.0 / epoch.sigma_T**2)
    x = np.zeros(6)
    for model_error in (0.03, 0.0):
        sigma = np.hypot(epoch.sigma_T, model_error * magnitude)[:, None]

        def residual(x, sigma=sigma):
            turned = Rotation.from_rotvec(x[3:]).as_matrix() @ rotation
            return ((epoch.field_T - model.field(position + x[:3]) @ turned) / sigma).ravel()

        x = least_squares(residual, x, x_scale="jac").x
    return position + x[:3]


def walk(site, rng, count):
    """Epochs of a sensor that walks through the cube at 0.2 m/s and keeps its attitude."""
    time_s = 0.1 * np.arange(count)
    middle, turn = np.array([1.065, 1.065, 0.9]), time_s * 0.2 / 0.6
    position = middle + 0.6 * np.stack([np.cos(turn), np.sin(turn), 0.3 * np.sin(2 * turn)], axis=1)
    rotation = Rotation.random(rng=rng).as_matrix()
    field = bench.magpylib_fields(site, position) @ rotation
    sigma = site.sensor.noise_T / np.sqrt(bench.CHIPS)
    field = field + sigma * rng.normal(size=field.shape)
    names = tuple(beacon.id for beacon in site.beacons)
    return [Fields(i, time_s[i], names, field[i], np.full(len(names), sigma)) for i in range(count)]


def elsewhere(scale=1.0):
    """Time of single epochs that take more than the chain of magnitudes, ms: median, 99 % and worst of each kind.

    Five beacons of the cube, too few for its answer to be taken unsearched; eight of which one is at fault, or two; and
    eight with a sensor that is, or fields that nothing explains.
    """
    count = max(int(scale * 1000), 12)
    five, eight = bench.prigge_cube(keep=(0, 1, 3, 4, 6)), bench.prigge_cube()
    rng = np.random.default_rng(107)
    work = {"five beacons": (five, bench.trials(five, bench.cube_positions(rng, count), rng))}
    some = count // len(bench.FAULTS)

    def sound():
        return bench.trials(eight, bench.cube_positions(rng, some), rng)

    for kind in bench.FAULTS:
        row = int(rng.integers(len(eight.beacons)))
        work[f"one of eight: {kind}"] = eight, bench.with_fault(kind, eight, sound(), rng, row)
    two = bench.with_fault("dead", eight, bench.with_fault("polarity", eight, sound(), rng, 1), rng, 6)
    work["two of eight: polarity, dead"] = eight, two
    for name, gains in (("gain of one axis +20%", [1.2, 1.0, 1.0]), ("one axis reversed", [-1.0, 1.0, 1.0])):
        run = sound()
        work[name] = eight, replace(run, field_T=run.field_T * gains)
    run = sound()
    work["fields in other places"] = eight, replace(run, field_T=run.field_T[:, rng.permutation(len(eight.beacons))])
    run = sound()
    noise = 30.0 * run.sigma_T[..., None] * rng.normal(size=run.field_T.shape)
    work["noise, 30 times as said"] = eight, replace(run, field_T=noise)
    result = {}
    for name, (site, run) in work.items():
        ms = 1e3 * np.array(times_s(site, run, count))
        result[name] = {
            "epochs": len(ms),
            "median_ms": float(np.median(ms)),
            "of_99_percent_ms": float(np.quantile(ms, 0.99)),
            "worst_ms": float(ms.max()),
        }
    return result

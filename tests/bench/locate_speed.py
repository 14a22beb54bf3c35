"""Location by `scipy.optimize.least_squares` with our steps and starts, a walk, and how long hard epochs take."""

from __future__ import annotations

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

    Five beacons of the cube, too few for its answer to be taken unsearched, and eight of which one is at fault.
    """
    count = max(int(scale * 1000), 12)
    five, eight = bench.prigge_cube(keep=(0, 1, 3, 4, 6)), bench.prigge_cube()
    rng = np.random.default_rng(107)
    work = {"five beacons": (five, bench.trials(five, bench.cube_positions(rng, count), rng))}
    for kind in bench.FAULTS:
        sound = bench.trials(eight, bench.cube_positions(rng, count // len(bench.FAULTS)), rng)
        row = int(rng.integers(len(eight.beacons)))
        work[f"one of eight: {kind}"] = eight, bench.with_fault(kind, eight, sound, rng, row)
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

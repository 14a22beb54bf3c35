"""What calibrating a sensor by hand reaches: simulated benches, the firmware on host boards, 60 s of turning each.

``make calibration-figures`` prints, for a quiet and a noisy sensor, on exact and on surveyed sites, ten seeds each: the
errors of the sensor's matrix against the true site file of the bench, beside the deviations that are told.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np

from goldfield.calibration.sensor import calibrate_sensor
from goldfield.calibration.turn import turn_of_reports
from hil_sim import scenario
from hil_sim.bench import SimulatedBench
from tests.command import real_number, whole_number

UPPER = np.triu_indices(3)
GAINS, LEANS = [0, 3, 5], [1, 2, 4]
SENSOR = "sensor_gain_sd = 0.01\nsensor_axis_sd_rad = 0.01\nsensor_offset_sd_T = 1e-6\n"
TURNING = '[motion]\nkind = "turning"\nposition_m = [0.9, 1.2, 0.8]\nseconds = 600.0\nsway_m = 0.01\n\n'
SITES = {
    "exact": "",
    "surveyed": "position_sd_m = 0.003\naxis_sd_rad = 0.005\ncurrent_sd = 0.003\n",
}
"""Errors of installation besides the sensor's. With "exact" the mains of the bench still leave a constant part in each
beacon's field, since a cycle is five of their periods: at 0.2 mG it is what limits the common gain."""
NOISE = {"2 mG": "noise_T = 2.0e-7", "0.2 mG": "noise_T = 2.0e-8\nconverter_noise_LSB = 0.05"}


def bench_file(directory: Path, errors: str, noise: str) -> Path:
    """Write the bench prigge8 with a sensor that a hand turns."""
    text = scenario.find("prigge8").read_text().replace("noise_T = 2.0e-7", noise, 1)
    head, rest = text.split("[motion]")
    path = directory / "bench.toml"
    path.write_text(f"{head}{TURNING}[installation]\n{SENSOR}{errors}\n{rest[rest.index('[coil]') :]}")
    return path


def one(directory: Path, errors: str, noise: str, seed: int, seconds: float) -> dict[str, float]:
    """Return the figures of one bench."""
    path = bench_file(directory, errors, noise)
    text = path.read_text()
    path.write_text(text.replace("seed = 1\n", f"seed = {seed}\n", 1))
    bench = SimulatedBench(str(path), "host", directory)
    try:
        reports = bench.reports(round(seconds / bench.site.cycle_s))
        site, true_site = bench.site, scenario.true_site_toml(bench.scenario)
    finally:
        bench.close()
    true = np.array(tomllib.loads(true_site)["sensor"]["axes"])
    offset_T = np.array(json.loads(true_site.split("# The sensor reads ")[1].split(" T where")[0]))
    start_s = time.process_time()
    found = calibrate_sensor(site, turn_of_reports(site, reports))
    used_s = time.process_time() - start_s
    error = (found.axes - true)[UPPER]
    common = float(error[GAINS].mean())
    off_T = found.offset_T - offset_T
    return {
        "gain": float(np.abs(error[GAINS]).max()),
        "common": common,
        "relative": float(np.sqrt(np.mean((error[GAINS] - common) ** 2))),
        "relative_sd": found.relative_sd,
        "lean": float(np.sqrt(np.mean(error[LEANS] ** 2))),
        "gain_sd": found.gain_sd,
        "lean_sd": float(np.sqrt(np.mean(np.diag(found.covariance)[LEANS]))),
        "nees": float(error @ np.linalg.solve(found.covariance, error)) / 6.0,
        "offset_nT": 1e9 * float(np.sqrt(np.mean(off_T**2))),
        "offset_sd_nT": 1e9 * float(np.sqrt(np.mean(found.offset_sd_T**2))),
        "residual": found.residual,
        "cpu_s": used_s,
    }


def main() -> None:
    """Print a line for each noise and site."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=whole_number(1), default=10)
    parser.add_argument("--noise", choices=NOISE, action="append", help="only this one")
    parser.add_argument("--site", choices=SITES, action="append", help="only this one")
    parser.add_argument("--seconds", type=real_number(1.0), default=60.0)
    parser.add_argument("--each", action="store_true", help="print every seed")
    arguments = parser.parse_args()
    print("rms over the seeds, in parts of a million; largest gain error; NEES of six elements; offset in nT")
    print(
        f"{'noise':<7} {'site':<9} {'common':>7} {'(sd)':>7} {'relative':>8} {'(sd)':>6} {'lean':>6} {'(sd)':>6} "
        f"{'largest':>8} {'NEES':>5} {'offset':>7} {'(sd)':>5} {'resid':>5} {'cpu/s':>5}"
    )
    for noise in arguments.noise or NOISE:
        for site in arguments.site or SITES:
            with tempfile.TemporaryDirectory() as directory:
                seeds = range(1, arguments.seeds + 1)
                runs = [one(Path(directory), SITES[site], NOISE[noise], seed, arguments.seconds) for seed in seeds]
            if arguments.each:
                for run in runs:
                    print(json.dumps(run))
            rms = {key: float(np.sqrt(np.mean([run[key] ** 2 for run in runs]))) for key in runs[0]}
            largest, nees = max(run["gain"] for run in runs), float(np.mean([run["nees"] for run in runs]))
            print(
                f"{noise:<7} {site:<9} {1e6 * rms['common']:7.1f} {1e6 * rms['gain_sd']:7.1f} "
                f"{1e6 * rms['relative']:8.2f} {1e6 * rms['relative_sd']:6.2f} {1e6 * rms['lean']:6.1f} "
                f"{1e6 * rms['lean_sd']:6.1f} {1e6 * largest:8.0f} {nees:5.2f} {rms['offset_nT']:7.2f} "
                f"{rms['offset_sd_nT']:5.2f} {rms['residual']:5.2f} {rms['cpu_s']:5.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()

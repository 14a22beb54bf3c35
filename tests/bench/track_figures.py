"""Print what is reached on a moving sensor: maths.md, 4, and the goals for tracking; all from seeded runs.

World: magpylib's coils, codes from shift registers, a sample at the end of each chip of a sensor that moves all the
time. Prigge's cube; straight flights in random directions, attitudes and axes of turn, at least 0.25 m from a coil.
"""

from __future__ import annotations

import argparse
import timeit

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.access import Separator
from goldfield.access.moving import DriftSeparator
from goldfield.field import FieldModel
from goldfield.locate.fit import Measurements, fit_pose
from goldfield.track import (
    CycleData,
    CycleLocator,
    CycleObserver,
    EpochObserver,
    FixedLagSmoother,
    Tracker,
)
from goldfield.types import Fields, Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, circling, cycle_bound, epoch_bound, flight_poses, random_flight
from tests.command import whole_number

MOTIONS = ((0.0, 0.0, 2e-7), (1.0, 0.0, 2e-7), (0.0, 1.0, 2e-7), (1.0, 1.0, 2e-7), (1.0, 1.0, 5e-9))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def names(site):
    return tuple(beacon.id for beacon in site.beacons)


def least_squares(site, separation, flight):
    """Position that fits the fields of one epoch best, started at the truth so that no start can fail."""
    position, rotation = flight_poses(flight, 0.0)
    measurements = Measurements(separation.field_T[None], separation.sigma_T[None])
    fit = fit_pose(FieldModel(site.beacons), measurements, position[None], rotation.as_matrix()[None])
    return fit.position_m[0]


def one_cycle(speed, rate, noise_T, count):
    """Errors (m) of each way to process a single cycle, and the bound."""
    site = prigge_cube(noise_T)
    room, rng = Room(site), np.random.default_rng([3, int(speed), int(rate), round(noise_T * 1e9)])
    plain, drift = Separator(10, site.codes, noise_T), DriftSeparator(10, site.codes, noise_T)
    whole = CycleLocator(site)
    errors, contradicted = [], []
    for _ in range(count):
        flight = random_flight(site, rng, speed, rate)
        samples = room.samples(flight, 0.0, noise_T, rng)
        middle, end = flight_poses(flight, 0.0)[0], flight_poses(flight, site.cycle_s / 2)[0]
        patent = least_squares(site, plain.from_samples(samples), flight)
        ramp = least_squares(site, drift.from_samples(samples), flight)
        chips = whole.locate(CycleData(0, 0.0, names(site), samples)).pose
        found = [patent - end, patent - middle, ramp - middle, chips.position_m - middle]
        errors.append([*np.linalg.norm(found, axis=1), cycle_bound(room, flight, noise_T)])
        contradicted.append(chips.status is Status.INCONSISTENT)
    return np.array(errors), np.array(contradicted)


def print_cycle_table(count):
    print(f"One cycle, no prior; rms error, mm, of {count} flights each (bound: median, rms)")
    print(
        f"{'m/s':>4} {'rad/s':>5} {'mG':>5} {'end tag':>8} {'mid tag':>8} {'ramp':>7} {'chips':>7}",
        end="",
    )
    print(f" {'bound':>13} {'chips/bound':>12} {'flagged':>8}")
    for speed, rate, noise_T in MOTIONS:
        errors, contradicted = one_cycle(speed, rate, noise_T, count)
        end, middle, ramp, chips = (rms(errors[:, column]) * 1e3 for column in range(4))
        bound = errors[:, 4]
        print(
            f"{speed:4g} {rate:5g} {noise_T * 1e7:5g} {end:8.2f} {middle:8.2f} {ramp:7.2f} {chips:7.2f}"
            f" {np.median(bound) * 1e3:6.2f} {rms(bound) * 1e3:6.2f} {rms(errors[:, 3] / bound):12.3f}"
            f" {contradicted.sum():8d}",
            flush=True,
        )


def print_tracking_table(runs, length):
    noise_T = 2e-7
    site = prigge_cube(noise_T)
    room = Room(site)
    plain, drift = Separator(10, site.codes, noise_T), DriftSeparator(10, site.codes, noise_T)

    def fields(cycle, separator):
        separation = separator.from_samples(cycle.data_T)
        return Fields(cycle.epoch, cycle.time_s, names(site), separation.field_T, separation.sigma_T)

    def poses_of(track, data):
        return [track.update(epoch) for epoch in data]

    print(f"\nTracking, 2 mG, {runs} circles of {length} cycles; rms of error over the bound of the epoch alone; the")
    print("first 3 epochs left out. nees: normalised error squared per axis, position and attitude")
    for speed, rate in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)):
        ways: dict[str, list] = {}
        for run in range(runs):
            rng = np.random.default_rng([5, run])
            flight = circling(rng, speed, rate)
            times = site.cycle_s * np.arange(length)
            cycles = [CycleData(k, t, names(site), room.samples(flight, t, noise_T, rng)) for k, t in enumerate(times)]
            bound = np.array([epoch_bound(site, flight, t) for t in times])
            epochs = [fields(cycle, plain) for cycle in cycles]
            results = {
                "epochs": poses_of(Tracker(site), epochs),
                "epochs, smoothed by 6": list(FixedLagSmoother(site, Tracker(site), 6).poses(epochs)),
                "epochs without ramp": poses_of(
                    Tracker(site, EpochObserver(site, 2)), [fields(cycle, drift) for cycle in cycles]
                ),
                "samples": poses_of(Tracker(site, CycleObserver(site)), cycles),
            }
            for way, poses in results.items():
                for k, pose in enumerate(poses[3:], start=3):
                    position, rotation = flight_poses(flight, pose.time_s)
                    error = pose.position_m - position
                    turn = (rotation * Rotation.from_quat(pose.orientation_xyzw).inv()).as_rotvec()
                    ways.setdefault(way, []).append(
                        (
                            np.linalg.norm(error),
                            np.linalg.norm(error) / bound[k],
                            error @ np.linalg.solve(pose.position_cov_m2, error) / 3,
                            turn @ np.linalg.solve(pose.attitude_cov_rad2, turn) / 3,
                            pose.status is not Status.OK,
                        )
                    )
        for way, rows in ways.items():
            values = np.array(rows)
            print(
                f"  {speed:g} m/s {rate:g} rad/s  {way:22s} {rms(values[:, 0]) * 1e3:6.2f} mm"
                f"  ratio {rms(values[:, 1]):.3f}  nees {values[:, 2].mean():.2f} {values[:, 3].mean():.2f}"
                f"  not ok {int(values[:, 4].sum())}",
                flush=True,
            )


def print_time():
    site = prigge_cube(2e-7)
    room, rng = Room(site), np.random.default_rng(6)
    flight = circling(rng, 1.0, 1.0)
    plain = Separator(10, site.codes, 2e-7)
    cycles = [CycleData(k, k * 0.1, names(site), room.samples(flight, k * 0.1, 2e-7, rng)) for k in range(60)]
    separations = [plain.from_samples(cycle.data_T) for cycle in cycles]
    epochs = [
        Fields(c.epoch, c.time_s, c.beacons, s.field_T, s.sigma_T) for c, s in zip(cycles, separations, strict=True)
    ]
    for label, tracker, data in (
        ("separated fields", Tracker(site), epochs),
        ("samples", Tracker(site, CycleObserver(site)), cycles),
    ):
        tracker.update(data[0])
        spent = [timeit.timeit(lambda t=tracker, e=epoch: t.update(e), number=1) for epoch in data[1:]]
        print(
            f"  filter update, 8 beacons, {label}: median {np.median(spent) * 1e3:.2f} ms, least {min(spent) * 1e3:.2f}"
        )
    locator = CycleLocator(site)
    spent = [timeit.timeit(lambda c=cycle: locator.locate(c), number=1) for cycle in cycles[:20]]
    print(f"  one cycle of samples with no prior: median {np.median(spent) * 1e3:.1f} ms")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=whole_number(1), default=150)
    parser.add_argument("--circles", type=whole_number(1), default=6)
    arguments = parser.parse_args()
    print_cycle_table(arguments.flights)
    print_tracking_table(arguments.circles, 50)
    print("\nTime on this machine")
    print_time()


if __name__ == "__main__":
    main()

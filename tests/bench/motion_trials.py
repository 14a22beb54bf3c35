"""A moving sensor's samples, chip by chip; coils by magpylib, codes by shift registers: nothing of the host's."""

from __future__ import annotations

from dataclasses import dataclass

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.uncertainty import cramer_rao_bound

CHIPS = 1023
EARTH_T = np.array([2.0e-5, 0.0, -4.5e-5])


def gold_chips(code):
    """Chips, +1 or -1, of a Gold code of degree 10, by two shift registers."""
    u, v = [1] * 10, [1] * 10
    first, second = [], []
    for _ in range(CHIPS):
        first.append(u[9])
        second.append(v[9])
        u = [u[2] ^ u[9], *u[:9]]
        v = [v[1] ^ v[2] ^ v[5] ^ v[7] ^ v[8] ^ v[9], *v[:9]]
    return np.array([1 - 2 * (first[t] ^ second[(t + code) % CHIPS]) for t in range(CHIPS)])


@dataclass(frozen=True)
class Flight:
    """A path: position (m) and attitude as functions of times, shape (t,), s."""

    position: object
    rotation: object

    def poses(self, times):
        return self.position(times), self.rotation(times)


def straight(position, attitude, velocity, rate):
    """Return a flight at constant velocity and angular velocity (site's frame) through a pose at time 0."""
    return Flight(
        lambda t: position + np.outer(t, velocity), lambda t: Rotation.from_rotvec(np.outer(t, rate)) * attitude
    )


class Room:
    """Coils of a site as magpylib objects, and their codes."""

    def __init__(self, site):
        self.site = site
        self.codes = np.stack([gold_chips(beacon.code) for beacon in site.beacons], axis=1)
        self.coils = []
        for beacon in site.beacons:
            turn = Rotation.align_vectors(beacon.axis[None], [[0.0, 0.0, 1.0]])[0]
            self.coils.append(
                magpylib.current.Circle(
                    diameter=2 * beacon.radius_m,
                    current=beacon.turns * beacon.current_A,
                    position=beacon.position_m,
                    orientation=turn,
                )
            )

    def samples(self, flight, middle_s, noise_T, rng, earth_T=EARTH_T):
        """Samples at the ends of the chips of a cycle, shape (1023, 3), in the sensor's frame."""
        period = self.site.chip_period_s
        times = middle_s + (np.arange(CHIPS) + 1 - CHIPS / 2) * period
        position, rotation = flight.poses(times)
        fields = magpylib.getB(self.coils, position, squeeze=False)[:, 0, 0]  # (n, t, 3)
        total = np.einsum("tn,ntc->tc", self.codes, fields) + earth_T
        return rotation.inv().apply(total) + noise_T * rng.normal(size=(CHIPS, 3))


CLEARANCE_M = 0.25
"""Flights keep this far from the coils' centres: a sensor does not fly through a coil of 0.149 m radius."""


def random_flight(site, rng, speed, rate):
    """A straight flight at time 0 inside the cube of the site, in a random direction, attitude and axis of turn."""
    centres = np.array([beacon.position_m for beacon in site.beacons])
    low, high = centres.min(axis=0), centres.max(axis=0)
    while True:
        position = rng.uniform(low, high)
        if np.linalg.norm(centres - position, axis=1).min() > CLEARANCE_M:
            break
    velocity, turn = rng.normal(size=(2, 3))
    return straight(
        position,
        Rotation.random(rng=rng),
        speed * velocity / np.linalg.norm(velocity),
        rate * turn / np.linalg.norm(turn),
    )


def flight_poses(flight, time):
    """Position, shape (3,), and rotation at one moment."""
    position, rotation = flight.poses(np.array([time]))
    return position[0], rotation[0]


def cycle_bound(room, flight, noise_T):
    """Cramer-Rao bound of the position at mid-cycle, m, from all samples of a cycle.

    Unknown are position, attitude, velocity, angular velocity and the earth's field; derivatives by differences of
    magpylib's fields.
    """
    position, attitude = flight_poses(flight, 0.0)
    step = 1e-3
    ahead, behind = flight_poses(flight, step), flight_poses(flight, -step)
    velocity = (ahead[0] - behind[0]) / (2 * step)
    rate = (ahead[1] * behind[1].inv()).as_rotvec() / (2 * step)
    sizes = np.repeat([1e-5, 1e-5, 1e-4, 1e-4, 1e-9], 3)
    columns = []
    for column, size in enumerate(sizes):
        ends = []
        for sign in (1, -1):
            error = np.zeros(15)
            error[column] = sign * size
            moved = straight(
                position + error[:3],
                Rotation.from_rotvec(error[3:6]) * attitude,
                velocity + error[6:9],
                rate + error[9:12],
            )
            ends.append(room.samples(moved, 0.0, 0.0, np.random.default_rng(0), EARTH_T + error[12:]))
        columns.append(((ends[0] - ends[1]) / (2 * size)).ravel())
    jacobian = np.stack(columns, axis=1)
    scale = 1.0 / np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.inv((jacobian * scale).T @ (jacobian * scale)) * np.outer(scale, scale) * noise_T**2
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def circling(rng, speed, rate, radius=0.5):
    """Around a tilted circle about the middle of `prigge_cube`, turning about a fixed axis."""
    middle = np.array([1.065, 1.065, 0.89]) + rng.uniform(-0.3, 0.3, 3)
    tilt, attitude = Rotation.random(2, rng=rng)
    turn = rng.normal(size=3)
    turn *= rate / np.linalg.norm(turn)

    def position(times):
        angle = speed / radius * times
        return middle + tilt.apply(radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]))

    return Flight(position, lambda times: Rotation.from_rotvec(np.outer(times, turn)) * attitude)


def epoch_bound(site, flight, time):
    """Cramer-Rao bound of the position, m, from eight fields of a sensor at rest where it is at this time."""
    position, rotation = flight_poses(flight, time)
    bound = cramer_rao_bound(site, position[None], rotation.as_matrix()[None])[0]
    return float(np.sqrt(np.trace(bound[:3, :3])))

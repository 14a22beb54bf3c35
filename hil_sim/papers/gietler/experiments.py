"""The tracks of Gietler, Ammari & Zangl: emitters beside a conductor, and convergence from a poor guess."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from goldfield.track.motion import Agility, State
from goldfield.types import FloatArray
from hil_sim.papers.gietler.conductors import MATERIALS, host_response
from hil_sim.papers.gietler.tracker import EmitterBody, EmitterTracker, Noise, PlainFilter, euler_matrix
from hil_sim.world import emitter_world as world
from hil_sim.world.emitter_world import ComplexArray, Path, Secondary

CLEAR_M = 0.08
"""The sensor is never nearer to the conductor's centre."""

NEAR_M = 0.5
"""Errors beside a conductor count where the first emitter is at most this far from the sensor."""

AGILITY = Agility(world.VELOCITY_SIGMA, world.RATE_SIGMA, 0.0)
"""The paper's process noise."""

START = np.array([[0.01, 0.0, -0.005], [0.2, -0.2, 0.3], [0.0, 0.0, 0.0], [0.02, -0.05, 0.5 * math.pi]])
GUESS = np.array([[0.0, 0.0, 0.0], [0.05, -0.1, 0.4], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Start and guess of section III-C: velocity, position, rates, angles. The start's third angle is garbled in print; of
its readings pi/2 is the hard one."""

GUESS_DEVIATIONS = np.array([0.3, 1.0, 0.1, 0.3])
"""Standard deviations of the guess, in the order of `EmitterTracker`."""

START_BESIDE = np.array([[0.001, 0.001, 0.001], [0.0, 0.0, 0.2], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
"""The start beside a conductor, in the same order (section IV-C)."""

WIDENED = 0.02
"""Part of the field that is added to the noise in a filter's covariance, the old remedy against nonlinearity."""

MISTRUSTED = 0.2
"""The same for a base model that is told how wrong it is beside metal."""

KNOWN_DEVIATIONS = np.array([0.01, 0.05, 0.02, 0.1])
"""Standard deviations of the start, in the order of `EmitterTracker`, where it is known."""


@dataclass(frozen=True, eq=False)
class Track:
    """Errors along a path.

    Attributes
    ----------
    range_m, error_m, turn_rad : ndarray, shape (n,)
        Distance of the first emitter from the sensor, and errors of its position and of the attitude.
    position_m : ndarray, shape (n, 3)
        Estimated positions of the first emitter.
    """

    range_m: FloatArray
    error_m: FloatArray
    turn_rad: FloatArray
    position_m: FloatArray

    def rms(self, within_m: float = math.inf) -> tuple[float, float]:
        """Return the rms errors of position and attitude where the range is at most so much; NaN if nowhere."""
        near = self.range_m <= within_m
        if not near.any():
            return math.nan, math.nan
        return float(np.sqrt(np.mean(self.error_m[near] ** 2))), float(np.sqrt(np.mean(self.turn_rad[near] ** 2)))


def follow(path: Path, fields: ComplexArray, tracker: EmitterTracker | PlainFilter) -> Track:
    """Let a filter follow the fields of a path."""
    rotations = path.rotation
    position = np.empty_like(path.position_m)
    turn = np.empty(len(position))
    with np.errstate(all="ignore"):  # the plain filter may run away
        for step, field in enumerate(fields):
            if step:
                tracker.predict(world.STEP_S)
            state = tracker.update(field)
            position[step] = state.position_m
            turn[step] = np.arccos(np.clip(0.5 * (np.trace(rotations[step].T @ state.rotation) - 1.0), -1.0, 1.0))
    error = np.linalg.norm(position - path.position_m, axis=1)
    return Track(np.linalg.norm(path.position_m, axis=1), error, turn, position)


Model = tuple[EmitterBody, float]
"""Emitters with what is known of their conductor, and the relative error that the filter allows for."""


def models(shape: str, material: str, frequency_Hz: float) -> dict[str, Model]:
    """Return the models that are compared, by name."""
    base = EmitterBody(world.OFFSET_M, world.MOMENT_A_M2)
    trusted = Noise().model
    return {
        "base": (base, trusted),
        "base, mistrusted": (base, MISTRUSTED),
        "extended": (extended_body(shape, material, frequency_Hz), trusted),
    }


def extended_body(shape: str, material: str, frequency_Hz: float) -> EmitterBody:
    """Return the emitters with the host's model of the conductor."""
    conductivity, permeability = MATERIALS[material]
    if shape == "cube":
        conductivity = math.inf  # as its reference solution
    response = host_response(shape, conductivity, permeability, frequency_Hz)
    return EmitterBody(world.OFFSET_M, world.MOMENT_A_M2, response.parts(world.OFFSET_M, world.MOMENT_A_M2))


def beside_conductor(
    truth: Secondary, models: dict[str, Model], noise_A_m: float, seed: int, helix: bool = False
) -> tuple[Path, dict[str, Track]]:
    """Track one path with several models; the start is known, as in section IV-C."""
    rng = np.random.default_rng(seed)
    path = world.helix() if helix else world.brownian(START_BESIDE, 20.0, rng, CLEAR_M, world.CUBE_CENTRE_M)
    fields = world.measured(path, truth, noise_A_m, rng)
    agility = Agility(0.05, world.RATE_SIGMA, 0.0) if helix else AGILITY  # the helix turns at 0.024 m/s^2
    speed = (path.position_m[1] - path.position_m[0]) / world.STEP_S
    start = State(path.position_m[0], path.rotation[0], speed, np.zeros(3), np.zeros(3))
    tracks = {}
    for name, (body, error) in models.items():
        tracker = EmitterTracker(body, start, KNOWN_DEVIATIONS, agility, Noise(noise_A_m, error))
        tracks[name] = follow(path, fields, tracker)
    return path, tracks


def converged(track: Track) -> bool:
    """Tell whether the last five seconds are right: 5 % of the range and 0.1 rad."""
    last = slice(-round(5.0 / world.STEP_S), None)
    return bool((track.error_m[last] < 0.05 * track.range_m[last]).all() and (track.turn_rad[last] < 0.1).all())


def from_poor_guess(noise_A_m: float, seed: int) -> dict[str, Track]:
    """Track a path in air from the paper's initial guess: iterated filter, plain one, plain one told of more noise."""
    rng = np.random.default_rng(seed)
    path = world.brownian(START, 20.0, rng)
    fields = world.measured(path, None, noise_A_m, rng)
    body, noise = EmitterBody(world.OFFSET_M, world.MOMENT_A_M2), Noise(noise_A_m, 0.0)
    guess = State(GUESS[1], euler_matrix(GUESS[3]), GUESS[0], GUESS[2], np.zeros(3))
    return {
        "iterated": follow(path, fields, EmitterTracker(body, guess, GUESS_DEVIATIONS, AGILITY, noise)),
        "plain": follow(path, fields, PlainFilter(body, GUESS, GUESS_DEVIATIONS, AGILITY, noise)),
        "plain, noise widened": follow(
            path, fields, PlainFilter(body, GUESS, GUESS_DEVIATIONS, AGILITY, Noise(noise_A_m, WIDENED))
        ),
    }

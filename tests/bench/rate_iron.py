"""Metal that passes a tracked sensor: balls and sheets of iron, magnets, copper.

Each answers the field at its middle with a dipole, as small bodies do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import EARTH_T
from tests.bench.rate_ways import follow
from tests.bench.rate_world import World, motion_of

KG_M3, MAGNETISATION_A_m2_KG = 7870.0, 0.1
"""Density of iron, and its magnetic moment by mass that no field makes."""

SPEED_M_S, DISTANCE_M = 1.0, 0.3
"""How fast, seen from the sensor, and how near a thing passes it."""


@dataclass(frozen=True, eq=False)
class Thing:
    """What passes.

    Attributes
    ----------
    size_m3 : float
        Its dipole moment over the field that it answers, times mu0 / 4 pi: the cube of a ball's radius.
    flat : bool
        It answers only fields along its plane.
    own_A_m2 : float
        Magnetic moment that no field makes.
    still : bool
        It answers the field of the earth, too; copper does not.
    distance_m, speed_m_s : float
    """

    size_m3: float
    flat: bool
    own_A_m2: float
    still: bool
    distance_m: float
    speed_m_s: float


def ball(mass_kg, distance_m=DISTANCE_M, speed_m_s=SPEED_M_S, magnetisation_A_m2_kg=MAGNETISATION_A_m2_KG):
    """Return a ball of very permeable iron: m = 4 pi a^3 B / mu0 (Jackson, Classical Electrodynamics, 5.11)."""
    radius3_m3 = 3.0 * mass_kg / (4.0 * np.pi * KG_M3)
    return Thing(radius3_m3, False, magnetisation_A_m2_kg * mass_kg, True, distance_m, speed_m_s)


def sheet(radius_m, distance_m=0.4, speed_m_s=SPEED_M_S):
    """Return a thin round sheet of very permeable iron: m = 16/3 a^3 B / mu0 along it, none across (as the conducting
    disc of Landau and Lifshitz, Electrodynamics of Continuous Media, 4)."""
    return Thing(16.0 / 3.0 / (4.0 * np.pi) * radius_m**3, True, 0.0, True, distance_m, speed_m_s)


def copper(radius_m, distance_m=DISTANCE_M, speed_m_s=SPEED_M_S):
    """Return a ball that no changing field enters: m = -2 pi a^3 B / mu0; that of the earth does."""
    return Thing(-0.5 * radius_m**3, False, 0.0, False, distance_m, speed_m_s)


def passing(things, make, noise_T, name, seed, seconds):
    """Return the errors while things pass the sensor, nearest half way."""
    site = prigge_cube(noise_T)
    world, rng = World(site), np.random.default_rng([seed, 15])
    times = world.times(round(seconds / site.chip_period_s))
    position, rotation = motion_of(name, seed).poses(times)
    fields, ambient = world.fields(position), np.tile(EARTH_T, (len(times), 1))
    for thing in things:
        direction, aside = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        apart = thing.distance_m * aside + np.outer(times - seconds / 2.0, thing.speed_m_s * direction)
        own = rng.normal(size=3)
        own *= thing.own_A_m2 / np.linalg.norm(own)
        across = np.cross(direction, aside) if thing.flat else np.zeros(3)
        answer = thing.size_m3 / 1e-7 * (np.eye(3) - np.outer(across, across))
        fields = fields + _dipoles(-apart, world.fields(position + apart) @ answer)
        earth = np.tile(EARTH_T @ answer if thing.still else np.zeros(3), (len(times), 1, 1))
        ambient = ambient + _dipoles(-apart, earth + own)[:, 0]
    return follow(world.track(position, rotation, rng, noise_T, ambient_T=ambient, fields=fields), make(site))


def _dipoles(apart_m, moment_A_m2):
    """Return the fields of dipoles, shape (n, k, 3), at places so far from them, shape (n, 3)."""
    distance = np.linalg.norm(apart_m, axis=1)[:, None, None]
    towards = apart_m[:, None]
    along = (towards * moment_A_m2).sum(axis=2, keepdims=True)
    return 1e-7 * (3.0 * towards * along / distance**5 - moment_A_m2 / distance**3)

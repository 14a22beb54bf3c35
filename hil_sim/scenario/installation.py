"""Errors of installation: where the true bench differs from what the scenario, and so the site file, says.

A scenario with ``[installation]`` describes the bench as it was meant to be; `draw` makes the one that is there.
Coils are shifted and turned about their centres, anchors with their sensor; currents are off because the boards measure
them wrongly, which no board can notice; sensors have other gains, axes and zeros than their parameter page knows.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hil_sim.scenario.parts import CONVERTER_COUNTS, Beacon, FrontEnd, Sensor
from hil_sim.world.path import CoilGeometry

FloatArray = NDArray[np.float64]
SomeFrontEnd = TypeVar("SomeFrontEnd", bound=FrontEnd)


@dataclass(frozen=True)
class Installation:
    """Standard deviations of independent normal errors, and the seed that draws them.

    Attributes
    ----------
    seed : int
    position_sd_m : float
        Error of each coordinate of a coil's centre.
    axis_sd_rad : float
        Error of the angle by which a coil is turned about its centre, about each axis of the site.
    current_sd : float
        Error of a coil's current, relative.
    sensor_gain_sd : float
        Error of the gain of each sensitive axis, relative.
    sensor_axis_sd_rad : float
        Error of each of the three angles by which the sensitive axes lean: x toward y, x toward z, y toward z.
    sensor_offset_sd_T : float
        Error of the output of each axis at zero field.
    """

    seed: int = 0
    position_sd_m: float = 0.0
    axis_sd_rad: float = 0.0
    current_sd: float = 0.0
    sensor_gain_sd: float = 0.0
    sensor_axis_sd_rad: float = 0.0
    sensor_offset_sd_T: float = 0.0


EXACT = Installation()
INSTALLATION_KEYS = tuple(field.name for field in fields(Installation))


def draw(errors: Installation, beacons: tuple[Beacon, ...], sensor: Sensor) -> tuple[tuple[Beacon, ...], Sensor]:
    """Return the beacons and the sensor that are really there; the same errors make the same bench."""
    random = np.random.default_rng([errors.seed, 2])
    return tuple(_beacon(beacon, errors, random) for beacon in beacons), _front_end(sensor, errors, random)


def sensor_errors(believed: FrontEnd, true: FrontEnd) -> tuple[FloatArray, FloatArray]:
    """Return what the board's correction leaves of a sensor's errors: reading = matrix @ field + offset.

    Returns
    -------
    matrix : ndarray, shape (3, 3)
        Upper triangular, as both matrices of which it is made.
    offset_T : ndarray, shape (3,)
    """
    zero, correction = believed.correction()
    counts_per_T = CONVERTER_COUNTS / (2.0 * true.range_T)
    to_field = correction * counts_per_T
    true_zero = 0.5 * CONVERTER_COUNTS + true.offset_T * counts_per_T
    return to_field @ true.gain, correction @ (true_zero - zero)


def _beacon(beacon: Beacon, errors: Installation, random: np.random.Generator) -> Beacon:
    shift = errors.position_sd_m * random.normal(size=3)
    turn = Rotation.from_rotvec(errors.axis_sd_rad * random.normal(size=3))
    current = 1.0 + errors.current_sd * random.normal()
    sense = (1.0 + beacon.circuit.sense_gain_error) / current - 1.0
    centre = beacon.geometry.position_m
    anchor = beacon.sensor
    if anchor is not None:
        attitude = turn * Rotation.from_rotvec(anchor.rotation_vector_rad)
        anchor = replace(
            _front_end(anchor, errors, random),
            position_m=centre + turn.apply(anchor.position_m - centre),
            rotation_vector_rad=attitude.as_rotvec(),
        )
    second = None if beacon.second_coil is None else _turned(beacon.second_coil, turn)
    return replace(
        beacon,
        circuit=replace(beacon.circuit, sense_gain_error=sense),
        geometry=_turned(beacon.geometry, turn),
        second_coil=second,
        sensor=anchor,
    ).moved(shift)


def _turned(coil: CoilGeometry, turn: Rotation) -> CoilGeometry:
    points = None if coil.points_m is None else coil.position_m + turn.apply(coil.points_m - coil.position_m)
    return replace(coil, axis=turn.apply(coil.axis), points_m=points)


def _front_end(sensor: SomeFrontEnd, errors: Installation, random: np.random.Generator) -> SomeFrontEnd:
    gains = 1.0 + errors.sensor_gain_sd * random.normal(size=3)
    leaning = errors.sensor_axis_sd_rad * random.normal(size=3)
    offset_T = errors.sensor_offset_sd_T * random.normal(size=3)
    return replace(
        sensor,
        gain_error=(1.0 + sensor.gain_error) * gains - 1.0,
        misalignment_rad=sensor.misalignment_rad + leaning,
        offset_T=sensor.offset_T + offset_T,
    )

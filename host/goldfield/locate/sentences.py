"""What is said to people of a pose: one sentence each, with the figure and what to check."""

from __future__ import annotations

import math
from collections.abc import Sequence

from goldfield.errors import counted
from goldfield.types import FloatArray

MIRRORED = (
    "the fields fit with the sensor's axes mirrored (or all coils reversed): "
    "check the wiring of x, y, z and of the coils"
)

OUTSIDE = "the only pose that fits is on the wrong side of the half-space: check [site] half_space"

STRANGE = (
    "the pose is outside the room in which the metal was learned ([metal] walked_m): walk there and survey again, "
    "or take the pose with care"
)

BOUNDED = "the search came to its end before it could show that no other pose fits better"

NOISE = "the fields are nothing but noise: check that the beacons are on and that the sensor hears them"

NO_FIT = "no pose was found from which a fit goes on"

UNHEARD = "no place was found for these fields at which the beacons would be heard"

NOT_MENDED = (
    "no pose fits the fields, and leaving out one beacon or two does not mend it: check the site file and noise_T"
)

NOT_EXPLAINED = (
    "no pose fits the fields, and the search for the reason came to its end: check noise_T and the site file"
)

NOT_CLEAR = "no pose fits the fields, and several explanations fit about alike: check noise_T and the site file"


def unheard(explanation: str | None) -> str:
    """Say that there is no place, and what explains the fields if anything does."""
    return UNHEARD if explanation is None else f"{UNHEARD}; {explanation}"


def strength(factor: float) -> str:
    """Say that all fields are larger or smaller by one factor."""
    return (
        f"all fields are {factor:.3g} times those of the site file: check the sensor's gain and all coils' "
        "currents, turns and radii"
    )


def units(what: str, said: str, real: str, factor: float) -> str:
    """Say that lengths of the site file are in other units."""
    return (
        f"all fields are {factor:.3g} times those of the site file, as if its {what} were {said} "
        f"taken for {real}: check the units"
    )


def gauss(factor: float) -> str:
    """Say that the fields are in gauss."""
    return (
        f"all fields are {factor:.3g} times those of the site file, as if they were in gauss and taken for tesla: "
        "check the units"
    )


def nearly(text: str) -> str:
    """Say what explains most of the fields, but not within the noise."""
    return f"no pose fits the fields within noise_T, but nearly: {text}"


def axis_gain(axis: str, factor: float) -> str:
    """Say that one axis of the sensor has another gain."""
    if abs(factor) < 0.02:
        return f"the sensor's {axis} axis shows nothing: check its wiring"
    if abs(factor + 1.0) < 0.02:
        return f"the sensor's {axis} axis is reversed: check its wiring"
    return f"the sensor's {axis} axis shows {factor:.3g} times the field: check its gain"


def distorted(gains: FloatArray) -> str:
    """Say that the sensor distorts all fields alike."""
    said = ", ".join(f"{gain:.3g}" for gain in gains)
    return (
        f"the fields fit with a sensor of gains {said} along three directions: check for iron beside it, "
        "and that its axes are square and equal"
    )


def dead(beacon: str) -> str:
    """Say that a beacon has no field."""
    return f"{beacon} has no field: check its supply, its coil and its code"


def turned_round(beacon: str) -> str:
    """Say that a beacon's field is reversed."""
    return f"{beacon} is reversed: check the wires of its coil, or its axis in the site file"


def current(beacon: str, factor: float) -> str:
    """Say that a beacon's field is larger or smaller by a factor."""
    return f"{beacon} has {factor:.3g} times the field of the site file: check its current, turns and radius"


def moved(beacon: str, place: FloatArray, distance_m: float) -> str:
    """Say that a beacon is at another place."""
    said = ", ".join(f"{coordinate:.2f}" for coordinate in place)
    return f"{beacon} fits better at ({said}) m, {distance_m:.2g} m away: check where it is and how it is turned"


def other(beacon: str, residual: float) -> str:
    """Say that a beacon is not as the site says, in no simpler way."""
    return (
        f"{beacon} is not as the site file says, {residual:.0f} standard deviations off: check its place, axis, "
        "current and code"
    )


def left_out(texts: Sequence[str]) -> str:
    """Say that beacons were left out."""
    return "left out: " + "; ".join(texts)


def not_sure(texts: Sequence[str]) -> str:
    """Say that more than one explanation is left."""
    return "no pose fits all fields; it may be that " + ", or that ".join(texts)


def too_few(heard: int) -> str:
    """Say that the beacons are too few to tell which is wrong."""
    return f"no pose fits the fields, and {heard} beacons are too few to tell what is wrong: check the site file"


def few_heard(heard: int, least: int) -> str:
    """Say that the beacons are too few for a pose."""
    return f"{heard or 'no'} beacon{'s were' if heard != 1 else ' was'} heard, a pose needs {least}"


def few_components(count: int, unknowns: int) -> str:
    """Say that there are fewer numbers than unknowns."""
    return f"{counted(count, 'components were measured')}, a pose needs {unknowns}"


def ambiguous(place: FloatArray) -> str:
    """Say that another pose fits as well."""
    said = ", ".join(f"{coordinate:.2f}" for coordinate in place)
    return f"a pose at ({said}) m fits the fields as well"


def weak(deviation_m: float, nearest_m: float, deviation_rad: float) -> str:
    """Say that the fields do not fix the pose."""
    return (
        f"the standard deviation is {deviation_m:.2g} m and {deviation_rad:.2g} rad along the worst axes, "
        f"{nearest_m:.2g} m from the nearest coil: the beacons heard do not fix the pose"
    )


def unverified(beacon: str, protection_m: float, limit_m: float) -> str:
    """Say that a fault of a beacon could hide an error above the alert limit."""
    error = f"an error of {protection_m:.2f} m" if math.isfinite(protection_m) else "any error"
    return f"a fault of {beacon} could hide {error}; the alert limit is {limit_m:.2f} m"

"""A site: which beacons stand where, with which coil and code, and how noisy the sensor is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from goldfield.errors import UserError
from goldfield.site.board_keys import UNNAMED, BeaconBoard
from goldfield.site.drive import NO_CODE, NOTHING_ELSE, Drive
from goldfield.site.metal import BeaconMetal, Metal
from goldfield.types import FloatArray

AMBIENT_GRADIENT_T_M = 3e-6
"""Default of how uneven the ambient field usually is, T/m: that of a room without steel near the paths walked."""

ALERT_LIMIT_M = 0.5
"""Default of the alert limit, m.

Sound poses with a protection level below it, of 400 each: in halls of 10 x 10 x 3.5 m with coils of any place, axis and
strength and fields known to 0.2 mG over the root of the chips, 60 % with 4 beacons, 77 % with 5, 91 % with 6, 98 % with
8, 99 % with 12; in a cube of 2 m with eight all of them. Half of it would leave about 92 % with 8 beacons in the halls;
twice as much 75 % with 4, where one beacon's fault cannot be told from a pose elsewhere anyway.
"""


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The side of a plane where the sensor is: ``(p - point_m) . normal >= 0``.

    Attributes
    ----------
    point_m : ndarray, shape (3,)
    normal : ndarray, shape (3,)
        Unit vector.
    """

    point_m: FloatArray
    normal: FloatArray

    def contains(self, position_m: FloatArray) -> bool:
        """Tell whether a position, shape (3,), lies on the sensor's side."""
        return bool((position_m - self.point_m) @ self.normal >= 0.0)


USUAL_HUM_HZ = 50.0
"""The mains of most countries."""


@dataclass(frozen=True, eq=False)
class SensorSite:
    """The sensor as the site file describes it.

    Attributes
    ----------
    noise_T : float
        Standard deviation of one chip's sample on one axis; of axes that differ the root mean square.
    gain_sd : float
        Standard deviation of each axis's gain, relative.
    axis_sd_rad : float
        Standard deviation of the angle by which each axis leans towards each of the two others.
    axes : ndarray, shape (k, 3), or None
        Row j is the direction of axis j times its gain: axis j reads ``axes[j] @ B`` of a field B in the sensor's
        frame. Three axes may be left-handed. The frame of a sensor with fewer is that of its axes: the first is x, the
        second in the plane of x and y. None: the identity.
    noise_ratio : ndarray, shape (k,), or None
        Noise of each axis over ``noise_T``. None: alike.
    lever_m : ndarray, shape (k, 3), or None
        Where each axis reads, from the sensor's reference point, in its frame. None: all at that point.
    hum_T : float
        Root mean square of the mains' hum in the samples of an axis, over time and axes.
    hum_Hz : float
        Frequency of the mains.
    """

    noise_T: float
    gain_sd: float = 0.0
    axis_sd_rad: float = 0.0
    axes: FloatArray | None = None
    noise_ratio: FloatArray | None = None
    lever_m: FloatArray | None = None
    hum_T: float = 0.0
    hum_Hz: float = USUAL_HUM_HZ


@dataclass(frozen=True)
class Survey:
    """How far a coil may be from what the site says of it: standard deviations, all independent, zero for an exact one.

    Attributes
    ----------
    position_sd_m : float
        Deviation of each coordinate of the centre.
    axis_sd_rad : float
        Deviation of the angle by which the coil is turned about its centre, about each axis of the site.
    current_sd : float
        Deviation of the current, relative; turns and area count with it, since they change the field alike.
    """

    position_sd_m: float = 0.0
    axis_sd_rad: float = 0.0
    current_sd: float = 0.0


EXACT = Survey()


@dataclass(frozen=True, eq=False)
class Beacon:
    """A coil at a known place.

    Attributes
    ----------
    id : str
        Name of the beacon, different for each beacon of a site.
    position_m : ndarray, shape (3,)
        Centre of the coil, m; for a coil given by its wire, the mean of its points unless the file says otherwise.
    axis : ndarray, shape (3,)
        Unit vector; a positive current turns around it by the right-hand rule.
    turns : float
        Number of turns; for a coil given by its wire, how often the whole wire is repeated.
    radius_m : float or None
        Radius of a circular coil.
    points_m : ndarray, shape (n, 3), or None
        The wire as a polyline in the site's frame, in the direction of a positive current; exactly one of
        ``radius_m`` and ``points_m`` is given.
    current_A : float
        Amplitude of the chips; a negative one turns the moment round.
    code : int
        Index of the Gold code; `goldfield.site.drive.NO_CODE` unless the beacon has just one.
    drive : Drive
        Everything else that tells the beacon from others, and how fast its coil follows.
    survey : Survey
        How well position, axis and current are known.
    metal : BeaconMetal or None
        What metal in the room adds to the coil's field.
    board : BeaconBoard
        Which board drives the coil.
    """

    id: str
    position_m: FloatArray
    axis: FloatArray
    turns: float
    radius_m: float | None
    points_m: FloatArray | None
    current_A: float
    code: int
    drive: Drive = NOTHING_ELSE
    survey: Survey = EXACT
    metal: BeaconMetal | None = None
    board: BeaconBoard = UNNAMED

    @property
    def moment_A_m2(self) -> FloatArray:
        """Magnetic moment, shape (3,), A m^2: turns, current and area vector multiplied."""
        if self.points_m is not None:
            return self.turns * self.current_A * area_vector(self.points_m)
        assert self.radius_m is not None
        return self.turns * self.current_A * math.pi * self.radius_m**2 * self.axis

    @property
    def unknown_T(self) -> float:
        """Standard deviation of each component of the field through metal that is not described, T."""
        return 0.0 if self.metal is None else abs(self.current_A) * self.metal.metal.sd_T_A


@dataclass(frozen=True, eq=False)
class Site:
    """A site: everything that the host knows before the first sample; `goldfield.site.load` reads it from a file.

    Attributes
    ----------
    name : str
    chip_period_s : float
        Duration of a chip.
    degree : int
        Degree of the Gold codes: a cycle has ``2**degree - 1`` chips; 0 where ``samples`` says how many.
    half_space : HalfSpace or None
    sensor : SensorSite
    beacons : tuple of Beacon
        Ids are unique, plain codes too unless ``shared_codes``, and frequencies with their waves.
    access : str
        Way in which beacons are told apart: "cdma", "tdma" or "fdma".
    slots : int
        Number of time slots in a cycle for "tdma", else 0.
    alert_limit_m : float
        Largest error of a position that its user can bear: a pose is ``ok`` only if no fault of a single beacon could
        hide a larger one (`goldfield.Pose.protection_m`).
    ambient_gradient_T_m : float
        By how much the ambient field usually differs from place to place, a metre. What changes it by more as a sensor
        moves is taken for iron by tracking from blocks (docs/blocks.md, "Uneven field").
    assumed : tuple of str
        What the site file says nothing of and is assumed in its place, as ``"[survey] current_sd = 0.003"``.
    doubts : tuple of str
        Sentences on values that are unusual, as lengths in millimetres are.
    metal : Metal or None
        The metal of the room, as far as a survey has learned it; each beacon has its own part of it.
    samples : int
        Samples of a window of tones of unknown phase, of one ``chip_period_s`` each; 0: ``degree`` says how many.
    shared_codes : bool
        Whether beacons that are far from each other have the same code: which of them a sensor hears is told by the
        others that it hears (`goldfield.access.users`).
    """

    name: str
    chip_period_s: float
    degree: int
    half_space: HalfSpace | None
    sensor: SensorSite
    beacons: tuple[Beacon, ...]
    access: str = "cdma"
    slots: int = 0
    alert_limit_m: float = ALERT_LIMIT_M
    ambient_gradient_T_m: float = AMBIENT_GRADIENT_T_M
    assumed: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    metal: Metal | None = None
    samples: int = 0
    shared_codes: bool = False

    @property
    def chips(self) -> int:
        """Chips in a cycle, N, or samples in a window."""
        return self.samples or (1 << self.degree) - 1

    @property
    def cycle_s(self) -> float:
        """Duration of a cycle."""
        return self.chips * self.chip_period_s

    @property
    def codes(self) -> tuple[int, ...]:
        """Code index of each beacon.

        Raises
        ------
        UserError
            If a beacon has not just one plain code: a sensor's correlations then do not hold its field.
        """
        for beacon in self.beacons:
            if beacon.code == NO_CODE:
                raise UserError(
                    f'beacon "{beacon.id}" of the site "{self.name}" has no plain code: a sensor board correlates with '
                    'one Gold code a beacon; give each beacon a code, or use "goldfield separate" on raw samples'
                )
        return tuple(beacon.code for beacon in self.beacons)

    def beacon(self, beacon_id: str) -> Beacon:
        """Return the beacon of this id; KeyError if there is none."""
        for beacon in self.beacons:
            if beacon.id == beacon_id:
                return beacon
        raise KeyError(beacon_id)


def area_vector(points_m: FloatArray) -> FloatArray:
    """Return the area vector of a polyline that is closed by its chord: area times normal, m^2, shape (3,).

    It is half the sum of r x dr along the line, which for a coil of one turn and 1 A is the magnetic moment.

    Parameters
    ----------
    points_m : ndarray, shape (n, 3)
        Points in the direction of a positive current.

    Examples
    --------
    >>> area_vector(np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, 0.1, 0.0], [0.0, 0.1, 0.0]])).round(6).tolist()
    [0.0, 0.0, 0.02]
    """
    relative = points_m - points_m.mean(axis=0)
    return np.asarray(0.5 * np.cross(relative, np.roll(relative, -1, axis=0)).sum(axis=0), dtype=np.float64)

"""What goes into a survey and what comes out of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from goldfield.site import Site
from goldfield.types import Fields, FloatArray


class Free(StrEnum):
    """Kinds of parameters that a survey can estimate."""

    POSITION = "position"
    """Where each coil stands."""
    AXIS = "axis"
    """Where each coil points."""
    CURRENT = "current"
    """How strong each coil is."""
    GAIN = "gain"
    """Gain of each axis of the sensor."""
    TILT = "tilt"
    """How far the sensor's axes are from right angles."""
    OFFSET = "offset"
    """A constant vector, in the sensor's frame, in every measured field."""
    LEVER = "lever"
    """Where each axis of the sensor reads, from its reference point."""
    FIELD = "field"
    """What metal in the room adds to each coil's field."""


@dataclass(frozen=True, eq=False)
class KnownPoint:
    """Where the sensor really was in an epoch.

    Attributes
    ----------
    epoch : int
        Number of the epoch, as in `Fields`.
    position_m : ndarray, shape (3,)
        In the site's frame; NaN for a coordinate that is not known.
    sigma_m : float
        Standard deviation of each known coordinate.
    """

    epoch: int
    position_m: FloatArray
    sigma_m: float


@dataclass(frozen=True)
class Distance:
    """A measured distance between the centres of two beacons."""

    beacons: tuple[str, str]
    distance_m: float
    sd_m: float


@dataclass(frozen=True, eq=False)
class Place:
    """A measured place of a beacon's centre: NaN for a coordinate that was not measured, as for a mere height."""

    beacon: str
    position_m: FloatArray
    sd_m: float


@dataclass(frozen=True, eq=False)
class Direction:
    """A measured direction of a beacon's axis, a unit vector, each of its two turns with the deviation ``sd_rad``."""

    beacon: str
    axis: FloatArray
    sd_rad: float


@dataclass(frozen=True)
class Current:
    """A measured current of a beacon; ``sd`` is relative."""

    beacon: str
    current_A: float
    sd: float


@dataclass(frozen=True, eq=False)
class SensorPlace:
    """Where the sensor of an anchor reads, from the centre of its coil and in its own frame; see `AnchorFields`."""

    beacon: str
    lever_m: FloatArray
    sd_m: float


Known = Distance | Place | Direction | Current
"""What is known of beacons by another measurement than that of their fields."""


@dataclass(frozen=True, eq=False)
class AnchorFields:
    """What the sensor of an anchor measured of the other beacons: it stands beside the centre of its own coil.

    Attributes
    ----------
    beacon : str
        Id of the anchor's own beacon.
    fields : Fields
        Fields in the frame of the anchor's sensor, averaged; the own beacon's is not used.
    lever_m : ndarray, shape (3,)
        Where the sensor reads, from the centre of the coil and in the frame of the sensor.
    lever_sd_m : float or None
        Standard deviation of each of its coordinates; None: nobody has measured it, so that it is found.
    """

    beacon: str
    fields: Fields
    lever_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    lever_sd_m: float | None = None


@dataclass(frozen=True, eq=False)
class SurveyData:
    """Everything that was measured.

    Attributes
    ----------
    epochs : tuple of Fields
        What the sensor measured on its walk; their numbers are unique.
    points : tuple of KnownPoint
        Where it was in some of these epochs.
    known : tuple of Known
    anchors : tuple of AnchorFields
    """

    epochs: tuple[Fields, ...]
    points: tuple[KnownPoint, ...] = ()
    known: tuple[Known, ...] = ()
    anchors: tuple[AnchorFields, ...] = ()

    def of_epochs(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> SurveyData:
        """Return the data with some of the epochs, without the known points of the others."""
        epochs = tuple(self.epochs[row] for row in np.arange(len(self.epochs))[rows].tolist())
        gone = {fields.epoch for fields in self.epochs} - {fields.epoch for fields in epochs}
        return replace(self, epochs=epochs, points=tuple(point for point in self.points if point.epoch not in gone))


@dataclass(frozen=True)
class Parameter:
    """An estimated number: its value, its standard deviation, and the value of before, in the unit of its name."""

    value: float
    sd: float
    before: float


@dataclass(frozen=True)
class Outlier:
    """An epoch that does not agree with the others.

    Attributes
    ----------
    epoch : int
    beacons : tuple of str
        Beacons whose fields are wrong in it; empty if no single one explains it.
    residual : float
        Root of its weighted mean square residual; sound ones are near 1.
    """

    epoch: int
    beacons: tuple[str, ...]
    residual: float


@dataclass(frozen=True, eq=False)
class MetalFound:
    """What epochs that were kept out say of the metal that was learned from the others: residuals, 1 for noise alone.

    Attributes
    ----------
    residual_without, residual_with : float
        Those of the site without any metal, and with what was learned.
    unseen_T : float
        Standard deviation of each component of a beacon's field below which metal would not be told from noise.
    without : Site
        The site as it was found without any metal.
    """

    residual_without: float
    residual_with: float
    unseen_T: float
    without: Site


@dataclass(frozen=True, eq=False)
class SurveyResult:
    """A survey: the site as it was found to be.

    Attributes
    ----------
    site : Site
        With the positions, axes, currents and axes of the sensor that were found, and their standard deviations.
    parameters : mapping of str to Parameter
        Everything that was estimated.
    covariance : ndarray, shape (6 n, 6 n)
        Covariance of all beacons, six rows each: position (m), turns about two vectors across the axis
        (`goldfield.survey.parameters.across`, rad), logarithm of the current. Rows of what was not estimated are zero.
        It is linear: where the turn of the whole site is known to degrees only, which is so without known points, it
        holds for distances and other things that a turn leaves as they are, and for places once the turn is known.
    residual_before, residual_after : float
        Roots of the weighted mean square residual over the sound epochs: of the site as it was, and as it was found.
    outliers : tuple of Outlier
    advice : tuple of str
        Sentences: through what origin, direction and scale are known, and what to measure next to gain most.
    position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
        Pose of each epoch; NaN for outliers.
    metal : MetalFound or None
        None unless the field was free.
    """

    site: Site
    parameters: Mapping[str, Parameter]
    covariance: FloatArray
    residual_before: float
    residual_after: float
    outliers: tuple[Outlier, ...]
    advice: tuple[str, ...]
    position_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    rotation: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))

    @property
    def deviation_m(self) -> float:
        """Standard deviation of a beacon's place, root of the mean square over the beacons, all three coordinates."""
        variance = np.diag(self.covariance).reshape(len(self.site.beacons), -1)[:, :3]
        return float(np.sqrt(variance.sum() / len(variance)))

    metal: MetalFound | None = None

"""Location of a sensor beside conductors that move with it: a robot's own body.

The beacons' fields drive eddy currents in the body and magnetise it; what they add at the sensor depends on the pose
and is far larger than the noise. It is predicted with the same conductor model that tracks emitters
(`goldfield.field.conductor`), at the frequencies of which the site's drives are composed (`goldfield.access.eddy`), and
taken off.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation

from goldfield.access.eddy import eddy_frequencies, eddy_weights
from goldfield.field import FieldModel
from goldfield.field.conductor.body_file import Conductor
from goldfield.field.dipole import dipole
from goldfield.locate.locator import Locator
from goldfield.site import Site
from goldfield.types import Fields, FloatArray, Pose, Status

ROUNDS = 12
SETTLED_M = 2e-5
SETTLED_RAD = 1e-4

SHELL = 3.0
"""Distance of the dipoles around a conductor from its centre, in radii of the ball around it."""

SURFACE_PIECES = 4
SMALLEST_SINGULAR = 1e-8

_GOLDEN = 0.5 * (1.0 + math.sqrt(5.0))
_DIRECTIONS = np.array(
    [np.roll([0.0, a, b * _GOLDEN], turn) for turn in range(3) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
) / math.hypot(1.0, _GOLDEN)
"""Corners of an icosahedron: three moments at each span all fields in a ball up to the fourth order."""


class OwnBody:
    """Conductors fixed to the sensor, among the beacons of a site.

    Each answers to the beacons as if it were alone: what currents in one induce in another is left out, the more the
    nearer they are to each other. Seen from the body each beacon is a dipole.

    Parameters
    ----------
    site : Site
    conductors : sequence of Conductor

    Raises
    ------
    UserError
        If the model does not hold for a conductor at a frequency of the site's drives (`field.conductor.respond`), or
        the site's beacons cannot be told apart.
    """

    def __init__(self, site: Site, conductors: Sequence[Conductor]) -> None:
        self._model = FieldModel(site.beacons)
        frequencies = eddy_frequencies(site)
        weights = eddy_weights(site, frequencies)
        self._answers = [_Answer(conductor, frequencies, weights) for conductor in conductors]

    def secondary(self, position_m: FloatArray, rotation: FloatArray) -> FloatArray:
        """Field that the body adds at the sensor to the separated field of each beacon.

        Parameters
        ----------
        position_m, rotation : ndarray, shapes (3,) and (3, 3)
            Pose of the sensor, ``B_site = R B_sensor``.

        Returns
        -------
        field_T : ndarray, shape (n, 3)
            Fields in the sensor's frame, of all beacons of the site.
        """
        source, moment = (self._model.centre_m - position_m) @ rotation, self._model.moment_A_m2 @ rotation
        total = np.zeros_like(source)
        for answer in self._answers:
            total += answer.field_T(source, moment)
        return total


class _Answer:
    """One conductor's field at the origin, as a linear map of the field that it stands in.

    The field of any far dipole is, inside the conductor, that of a few dipoles around it: their strengths follow from
    the field on its surface, and their answers are computed once. A dipole nearer than these is not quite as exact.
    """

    def __init__(self, conductor: Conductor, frequency_Hz: FloatArray, weights: NDArray[np.complex128]) -> None:
        self._corner_m = conductor.body(SURFACE_PIECES).corner_m
        extent_m = float(np.linalg.norm(self._corner_m - conductor.centre_m, axis=1).max())
        place = np.repeat(conductor.centre_m + SHELL * extent_m * _DIRECTIONS, 3, axis=0)
        moment = np.tile(np.eye(3), (len(_DIRECTIONS), 1))
        self._inverse = np.linalg.pinv(self._applied(place, moment), rcond=SMALLEST_SINGULAR)
        origin = np.zeros((1, 3))
        phasors = [one.parts(place, moment).field(origin)[:, 0] for one in conductor.responses(frequency_Hz)]
        found = mu_0 * np.einsum("jik,kbc->jcib", weights, np.array(phasors)).real
        self._found = found.reshape(3 * len(weights), -1)

    def field_T(self, source_m: FloatArray, moment_A_m2: FloatArray) -> FloatArray:
        """Field found in that of each beacon, dipoles of shape (n, 3): shape (n, 3)."""
        strength = self._inverse @ self._applied(source_m, moment_A_m2)
        return np.asarray((self._found @ strength.T.ravel()).reshape(-1, 3))

    def _applied(self, source_m: FloatArray, moment_A_m2: FloatArray) -> FloatArray:
        """Field of dipoles on the surface, shape (3 corners, dipoles)."""
        offset = self._corner_m.T[:, :, None] - source_m.T[:, None, :]
        return dipole(offset, moment_A_m2.T[:, None, :])[0].reshape(-1, len(source_m))


def locate_beside(locator: Locator, body: OwnBody, fields: Fields) -> Pose:
    """Locate a sensor beside its robot's body, with no prior.

    Locates, takes off what the body adds at that pose, and locates again until the pose settles: the body's field is a
    small part of the beacons', so each round shrinks the error by about that part.

    Returns
    -------
    Pose
        What `Locator.locate` returns; ``inconsistent`` also if the pose does not settle.
    """
    pose = locator.locate(fields)
    known = {beacon.id: row for row, beacon in enumerate(locator.site.beacons)}
    given = [index for index, name in enumerate(fields.beacons) if name in known]
    rows = [known[fields.beacons[index]] for index in given]
    axes = np.eye(3) if locator.site.sensor.axes is None else locator.site.sensor.axes
    if pose.status is Status.FAILED:
        return pose
    for _ in range(ROUNDS):
        rotation = Rotation.from_quat(pose.orientation_xyzw)
        corrected = fields.field_T.copy()
        added = body.secondary(pose.position_m, rotation.as_matrix())[rows] @ axes.T
        corrected[given, : len(axes)] -= added
        last, pose = pose, locator.locate(dataclasses.replace(fields, field_T=corrected))
        if pose.status is Status.FAILED:
            return pose
        turn = (Rotation.from_quat(pose.orientation_xyzw) * rotation.inv()).magnitude()
        if np.linalg.norm(pose.position_m - last.position_m) < SETTLED_M and turn < SETTLED_RAD:
            return pose
    return dataclasses.replace(pose, status=Status.INCONSISTENT)

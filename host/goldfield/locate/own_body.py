"""Location of a sensor beside a conductor that moves with it: a robot's own body.

The beacons' fields drive eddy currents in the body and magnetise it; what they add at the sensor depends on the pose
and is far larger than the noise. It is predicted with the same conductor model that tracks emitters
(`goldfield.field.conductor`), and taken off.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.field.conductor import Response
from goldfield.locate.locator import Locator
from goldfield.poses import Fields, FloatArray, Pose, Status

ROUNDS = 12
SETTLED_M = 2e-5
SETTLED_RAD = 1e-4


class OwnBody:
    """A conductor fixed to the sensor.

    Parameters
    ----------
    response : Response
        Of the body in the sensor's frame, the sensor at the origin and outside, at the frequency that stands for the
        beacons' signals. The part in phase is used: it hardly depends on the frequency where the skin is thin, as with
        metals, and is next to nothing where the body is transparent, as with carbon fibre.
    """

    def __init__(self, response: Response) -> None:
        self._response = response

    def secondary(self, model: FieldModel, position_m: FloatArray, rotation: FloatArray) -> FloatArray:
        """Field that the body adds to each beacon's at the sensor.

        Parameters
        ----------
        model : FieldModel
            n beacons; seen from the body each is taken for its dipole.
        position_m, rotation : ndarray, shapes (3,) and (3, 3)
            Pose of the sensor, ``B_site = R B_sensor``.

        Returns
        -------
        field_T : ndarray, shape (n, 3)
            In the sensor's frame.
        """
        parts = self._response.parts((model.centre_m - position_m) @ rotation, model.moment_A_m2 @ rotation)
        return np.asarray(mu_0 * parts.field(np.zeros((1, 3)))[:, 0].real)

    def predicted(self, model: FieldModel, position_m: FloatArray, rotation: FloatArray) -> FloatArray:
        """Field of each beacon with what the body adds, sensor's frame, shape (n, 3)."""
        return np.asarray(model.field(position_m) @ rotation + self.secondary(model, position_m, rotation))


def locate_beside(locator: Locator, body: OwnBody, fields: Fields) -> Pose:
    """Locate a sensor beside its robot's body, with no prior.

    Locates, takes off what the body adds at that pose, and locates again until the pose settles: the body's field is a
    small part of the beacons', so each round shrinks the error by about that part.

    Returns
    -------
    Pose
        As of `Locator.locate`; ``inconsistent`` also if it does not settle.
    """
    pose = locator.locate(fields)
    if pose.status is Status.FAILED:
        return pose
    known = {beacon.id: row for row, beacon in enumerate(locator.site.beacons)}
    given = [index for index, name in enumerate(fields.beacons) if name in known]
    model = locator.model.subset(np.array([known[fields.beacons[index]] for index in given], dtype=np.intp))
    for _ in range(ROUNDS):
        rotation = Rotation.from_quat(pose.orientation_xyzw)
        corrected = fields.field_T.copy()
        corrected[given] -= body.secondary(model, pose.position_m, rotation.as_matrix())
        last, pose = pose, locator.locate(dataclasses.replace(fields, field_T=corrected))
        if pose.status is Status.FAILED:
            return pose
        turn = (Rotation.from_quat(pose.orientation_xyzw) * rotation.inv()).magnitude()
        if np.linalg.norm(pose.position_m - last.position_m) < SETTLED_M and turn < SETTLED_RAD:
            return pose
    return dataclasses.replace(pose, status=Status.INCONSISTENT)

"""The scene of a site for Foxglove's 3D panel: coils coloured by health, and how sure the pose is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    Duration,
    KeyValuePair,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Vector3,
)
from foxglove.messages import Pose as FoxglovePose
from scipy.spatial.transform import Rotation

from goldfield.foxglove.messages import located, timestamp
from goldfield.site import Site
from goldfield.site.model import Beacon
from goldfield.types import FloatArray, Pose
from goldfield.view.beacon_state import BeaconState, beacon_state
from goldfield.view.coil_wires import site_box, wire_of
from goldfield.view.rep103 import MAP

Health = Mapping[str, Any]
"""The record of `goldfield.view.monitor.Monitor`."""

COLOURS = {
    BeaconState.UNKNOWN: Color(r=0.55, g=0.57, b=0.6, a=1.0),
    BeaconState.USED: Color(r=0.18, g=0.65, b=0.35, a=1.0),
    BeaconState.STRENGTH_OFF: Color(r=0.9, g=0.6, b=0.1, a=1.0),
    BeaconState.LEFT_OUT: Color(r=0.85, g=0.25, b=0.2, a=1.0),
    BeaconState.NOT_HEARD: Color(r=0.55, g=0.1, b=0.35, a=1.0),
}
"""Colour of a coil by what is known of its beacon."""
TEXT_COLOUR = Color(r=0.5, g=0.5, b=0.5, a=1.0)
BOX_COLOUR = Color(r=0.5, g=0.5, b=0.5, a=0.6)
ELLIPSOID_COLOUR = Color(r=0.2, g=0.5, b=0.95, a=0.45)
PROTECTION_COLOUR = Color(r=0.95, g=0.6, b=0.1, a=0.15)

SIGMAS = 2.0
"""Half axes of the ellipsoid in standard deviations."""
LIFETIME = Duration(1)
"""The ellipsoid of a pose vanishes if so long no other comes."""
FOREVER = Duration(0)
"""An entity with this lifetime stays until another of its name comes."""
UNTURNED = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
UNMOVED = FoxglovePose(position=Vector3(x=0.0, y=0.0, z=0.0), orientation=UNTURNED)
"""Foxglove's schemas require a pose, with both its parts, of everything that is drawn, though its panels take none."""
COIL_PART, BOX_PART, FONT_PART = 0.004, 0.0015, 0.03
"""Thickness of a wire, of the box's edges, and height of letters, each in the box's largest side."""

EDGES = ((0, 1), (1, 3), (3, 2), (2, 0), (4, 5), (5, 7), (7, 6), (6, 4), (0, 4), (1, 5), (2, 6), (3, 7))
"""Pairs of corners of a box that an edge joins, with x, y and z in the bits of their numbers."""


def scene(site: Site, unix_s: float, health: Health | None = None) -> SceneUpdate:
    """Return the site: a box around it, and each coil with its name, coloured by its health.

    Parameters
    ----------
    site : Site
    unix_s : float
        Time of the wall clock; an entity of the same name that was sent before is replaced.
    health : mapping, optional
        The record of a `goldfield.view.monitor.Monitor`; without it all coils are grey.
    """
    low, high = site_box(site)
    size_m = float((high - low).max())
    beacons = {} if health is None else health["beacons"]
    entities = [_coil(beacon, beacons.get(beacon.id), size_m, unix_s) for beacon in site.beacons]
    return SceneUpdate(entities=[_box(low, high, site.name, size_m, unix_s), *entities])


def pose_scene(pose: Pose, unix_s: float) -> SceneUpdate | None:
    """Return how sure a pose is: its ellipsoid of two standard deviations, and the sphere of its protection level.

    None for a pose without a place. The sphere is left out where nothing can be promised.
    """
    if not located(pose):
        return None
    ellipsoid = [] if (axes := _ellipsoid(pose)) is None else [axes]
    spheres = [_sphere(pose, pose.protection_m)] if math.isfinite(pose.protection_m) else []
    return SceneUpdate(
        entities=[
            SceneEntity(
                timestamp=timestamp(unix_s),
                frame_id=MAP,
                id="pose",
                lifetime=LIFETIME,
                spheres=[*ellipsoid, *spheres],
                metadata=[KeyValuePair(key="status", value=pose.status.value)],
            )
        ]
    )


def _coil(beacon: Beacon, health: Mapping[str, Any] | None, size_m: float, unix_s: float) -> SceneEntity:
    state = beacon_state(health)
    colour = COLOURS[state]
    wire_m = wire_of(beacon)
    radius_m = float(np.linalg.norm(wire_m - beacon.position_m, axis=1).max())
    return SceneEntity(
        timestamp=timestamp(unix_s),
        frame_id=MAP,
        id=f"beacon {beacon.id}",
        lifetime=FOREVER,
        lines=[
            LinePrimitive(
                type=LinePrimitiveLineType.LineStrip,
                pose=UNMOVED,
                thickness=COIL_PART * size_m,
                points=_points(wire_m),
                color=colour,
            )
        ],
        arrows=[
            ArrowPrimitive(
                pose=FoxglovePose(position=_vector(beacon.position_m), orientation=_towards(beacon.axis)),
                shaft_length=0.7 * radius_m,
                shaft_diameter=0.08 * radius_m,
                head_length=0.3 * radius_m,
                head_diameter=0.2 * radius_m,
                color=colour,
            )
        ],
        texts=[
            TextPrimitive(
                pose=FoxglovePose(
                    position=_vector(beacon.position_m + 1.3 * radius_m * beacon.axis), orientation=UNTURNED
                ),
                billboard=True,
                font_size=FONT_PART * size_m,
                color=TEXT_COLOUR,
                text=beacon.id,
            )
        ],
        metadata=[
            KeyValuePair(key="state", value=state.value),
            KeyValuePair(key="code", value=str(beacon.code)),
            *(KeyValuePair(key=key, value=str(value)) for key, value in (health or {}).items()),
        ],
    )


def _box(low: FloatArray, high: FloatArray, name: str, size_m: float, unix_s: float) -> SceneEntity:
    corners = np.array([[(low, high)[number >> axis & 1][axis] for axis in range(3)] for number in range(8)])
    return SceneEntity(
        timestamp=timestamp(unix_s),
        frame_id=MAP,
        id="site",
        lifetime=FOREVER,
        lines=[
            LinePrimitive(
                type=LinePrimitiveLineType.LineList,
                pose=UNMOVED,
                thickness=BOX_PART * size_m,
                points=_points(corners[np.array(EDGES).ravel()]),
                color=BOX_COLOUR,
            )
        ],
        metadata=[KeyValuePair(key="name", value=name)],
    )


def _ellipsoid(pose: Pose) -> SpherePrimitive | None:
    """Return the ellipsoid of a pose's position; None if its covariance is not known."""
    if not np.isfinite(pose.position_cov_m2).all():
        return None
    variances, axes = np.linalg.eigh(pose.position_cov_m2)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    return SpherePrimitive(
        pose=FoxglovePose(
            position=_vector(pose.position_m), orientation=_quaternion(Rotation.from_matrix(axes).as_quat())
        ),
        size=_vector(2.0 * SIGMAS * np.sqrt(np.maximum(variances, 0.0))),
        color=ELLIPSOID_COLOUR,
    )


def _sphere(pose: Pose, radius_m: float) -> SpherePrimitive:
    return SpherePrimitive(
        pose=FoxglovePose(position=_vector(pose.position_m), orientation=UNTURNED),
        size=_vector(np.full(3, 2.0 * radius_m)),
        color=PROTECTION_COLOUR,
    )


def _towards(axis: FloatArray) -> Quaternion:
    """Return the rotation that turns x, along which Foxglove's arrows point, to a unit vector."""
    middle = np.array([1.0, 0.0, 0.0]) + axis
    length = float(np.linalg.norm(middle))
    x, y, z = (0.0, 0.0, 1.0) if length < 1e-6 else (middle / length).tolist()
    return Quaternion(x=x, y=y, z=z, w=0.0)  # half a turn about the bisector


def _points(points_m: FloatArray) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in points_m.tolist()]


def _vector(values: FloatArray) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(xyzw: FloatArray) -> Quaternion:
    x, y, z, w = xyzw.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)

"""The bodies that move with the emitters: reference solutions of the simulated world, and the host's model of each."""

from __future__ import annotations

import math

import numpy as np

from goldfield.errors import UserError
from goldfield.field.conductor import Material, Response, ball, cuboid, respond
from goldfield.field.conductor.body import PIECES
from goldfield.field.conductor.interior import SKIN_RATIO
from hil_sim.world import boundary_elements as boundary
from hil_sim.world import emitter_world as world
from hil_sim.world.emitter_world import Secondary
from hil_sim.world.sphere import Sphere

MATERIALS = {"carbon": (1000.0, 1.0), "copper": (59.9e6, 1.0), "permeable": (1e5, 100.0)}
"""Conductivity in S/m and relative permeability of each material, by name."""

SPHERE_RADIUS_M = world.CUBE_EDGE_M * (0.75 / math.pi) ** (1.0 / 3.0)
"""The sphere with the cube's volume, around the same centre."""

VOLUME_PIECES = 9
"""A body that the field penetrates has three voxels a triangle, and a matrix over the voxels."""


def true_conductor(shape: str, material: str, frequency_Hz: float) -> Secondary:
    """Return the reference solution of a body under the emitters.

    Raises
    ------
    UserError
        There is none: of the cube only copper's, which is taken for a perfect conductor.
    """
    conductivity, permeability = MATERIALS[material]
    if shape == "sphere":
        sphere = Sphere(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, conductivity, permeability)
        return lambda point, source, moment: sphere.secondary(point, source, moment, frequency_Hz)
    if material != "copper":
        raise UserError(
            f"there is no reference solution of a cube of {material}: take --body sphere, or --material copper, which "
            "is taken for a perfect conductor"
        )
    cube = boundary.BoundaryElements(
        boundary.cube_surface(world.CUBE_CENTRE_M, world.CUBE_EDGE_M), boundary.PERFECT_CONDUCTOR
    )
    return lambda point, source, moment: cube.secondary(point, source, moment).astype(np.complex128)


def host_response(shape: str, conductivity_S_m: float, permeability: float, frequency_Hz: float) -> Response:
    """Return the host's model of the same body."""
    material = Material(conductivity_S_m, permeability)
    thin = material.skin_depth_m(frequency_Hz) < world.CUBE_EDGE_M / 2.0 / SKIN_RATIO
    pieces = PIECES if thin else VOLUME_PIECES
    if shape == "sphere":
        return respond(ball(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, material, pieces), frequency_Hz)
    return respond(cuboid(world.CUBE_CENTRE_M, np.full(3, world.CUBE_EDGE_M), material, pieces), frequency_Hz)

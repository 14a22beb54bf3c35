"""The explicit formula of a conductor's field beside the exact series of a sphere, and the paper's Tables I and II."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from goldfield.field.conductor import Parts, ball
from goldfield.field.conductor.interior import VolumeResponse
from hil_sim.papers.gietler.conductors import MATERIALS, SPHERE_RADIUS_M, VOLUME_PIECES, host_response
from hil_sim.world import boundary_elements as boundary
from hil_sim.world import emitter_world as world
from hil_sim.world.emitter_world import ComplexArray
from hil_sim.world.sphere import Sphere


@dataclass(frozen=True)
class FormulaError:
    """Largest relative errors of ways to compute a sphere's field, over emitters and points; NaN: does not apply.

    Attributes
    ----------
    skin_depths : float
        Radius over skin depth.
    host : float
        The host's model.
    given : float
        The explicit formula fed with the exact interior field.
    first_order : float
        The explicit formula fed with the currents that the emitters alone would drive.
    share : float
        The secondary field over the emitter's own, the largest.
    """

    skin_depths: float
    host: float
    given: float
    first_order: float
    share: float


POINTS_M = np.array([[0.05, 0.05, 0.0], [0.0, 0.0, -0.2], [0.3, 0.0, -0.1], [-0.2, 0.2, 0.1]])
"""Points where fields are compared, from the first emitter: the paper's point of observation first."""


def formula_error(conductivity_S_m: float, permeability: float, frequency_Hz: float) -> FormulaError:
    """Compare the explicit formula with the exact series of the sphere, at the paper's geometry."""
    sphere = Sphere(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, conductivity_S_m, permeability)
    emitters = list(zip(world.OFFSET_M, world.MOMENT_A_M2, strict=True))
    exact = np.array([sphere.secondary(POINTS_M, o, m, frequency_Hz) for o, m in emitters])
    size = np.linalg.norm(exact, axis=-1)

    def worst(parts: Parts) -> float:
        return float((np.linalg.norm(parts.field(POINTS_M) - exact, axis=-1) / size).max())

    response = host_response("sphere", conductivity_S_m, permeability, frequency_Hz)
    first_order = math.nan
    if permeability == 1.0:
        body = ball(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, response.body.material, VOLUME_PIECES)
        first = VolumeResponse(body, frequency_Hz, first_order=True)
        first_order = worst(first.parts(world.OFFSET_M, world.MOMENT_A_M2))
    # The voxels of a perfect ball: the flat triangles' corners at the true radius would leave out its outermost skin.
    voxel, volume = ball(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, response.body.material, 8).voxels(24)
    arm = voxel - world.CUBE_CENTRE_M
    radius = np.linalg.norm(arm.reshape(24, -1, 3), axis=2)
    node = 0.5 * (np.polynomial.legendre.leggauss(24)[0] + 1.0)
    place = world.CUBE_CENTRE_M + arm * (SPHERE_RADIUS_M * node[:, None] / radius).reshape(-1, 1)
    interior = [sphere.interior(place, o, m, frequency_Hz, 30) for o, m in emitters]
    field, curl = (np.stack(kind) for kind in zip(*interior, strict=True))
    given = worst(Parts.of_interior(place, volume, field, curl, permeability))
    own = [world.dipole_field(POINTS_M - o, m) for o, m in emitters]
    share = float((size / np.linalg.norm(own, axis=-1)).max())
    depths = SPHERE_RADIUS_M / response.body.material.skin_depth_m(frequency_Hz)
    return FormulaError(depths, worst(response.parts(world.OFFSET_M, world.MOMENT_A_M2)), given, first_order, share)


PRINTED = {
    "copper": np.array(
        [[230.310, 217.780, -123.660], [17.742, 4.450, -4.174], [-19.831, -10.634, -25.090]], dtype=complex
    ),
    "permeable": np.array(
        [
            [-248.620 + 91.751j, -245.780 + 88.301j, 379.540 - 71.226j],
            [13.957 + 8.412j, -228.560 + 2.317j, -1.376 - 2.981j],
            [-86.642 - 10.840j, 57.967 - 6.754j, -398.010 - 11.367j],
        ]
    ),
}
"""The finite-element rows of Tables I and II, taken for mA/m (printed mT): an emitter a row."""

TABLE_MOMENT_A_M2 = 0.01


def table(material: str, frequency_Hz: float) -> dict[str, ComplexArray]:
    """Return the secondary field of the paper's cube at its point of observation, mA/m, shape (3, 3), by name.

    The imaginary parts have the paper's sign: exp(-i omega t).
    """
    moment = TABLE_MOMENT_A_M2 * world.MOMENT_A_M2
    result = {"printed": PRINTED[material]}
    parts = host_response("cube", *MATERIALS[material], frequency_Hz).parts(world.OFFSET_M, moment)
    result["explicit formula"] = 1e3 * parts.field(POINTS_M[:1])[:, 0].conj()
    permeability = MATERIALS[material][1]
    cube = boundary.BoundaryElements(
        boundary.cube_surface(world.CUBE_CENTRE_M, world.CUBE_EDGE_M),
        boundary.PERFECT_CONDUCTOR if permeability == 1.0 else permeability,
    )
    solved = [cube.secondary(POINTS_M[:1], o, m)[0] for o, m in zip(world.OFFSET_M, moment, strict=True)]
    name = "boundary elements, perfect conductor" if permeability == 1.0 else "boundary elements, static"
    result[name] = 1e3 * np.array(solved, dtype=complex)
    return result


def agreement(a: ComplexArray, b: ComplexArray) -> tuple[float, complex]:
    """Return the ratio of lengths |b|/|a| and the complex cosine between two vectors, shape (3,)."""
    lengths = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return lengths[1] / lengths[0], complex(np.vdot(a, b) / (lengths[0] * lengths[1]))

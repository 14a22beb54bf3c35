"""The file of a robot's own body: the conductors that move with the sensor."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.field.conductor import Body, Material, Response, ball, cuboid, respond
from goldfield.field.conductor.interior import SKIN_RATIO
from goldfield.files.toml_table import Table, read_table
from goldfield.types import FloatArray

SKIN_PIECES, VOLUME_PIECES = 10, 6
"""Each edge of the surface is cut into so many; a body that the field penetrates has three voxels a triangle, and a
matrix over the voxels."""

FLATTEST = 4.0
"""Longest over shortest edge of a box: of flatter ones the model was never checked."""

KEYS = {"ball": ("radius_m",), "box": ("edges_m", "rotation_vector_rad")}


@dataclass(frozen=True, eq=False)
class Conductor:
    """A homogeneous conductor in the sensor's frame, the sensor at the origin.

    Attributes
    ----------
    material : Material
    centre_m : ndarray, shape (3,)
    radius_m : float or None
        Radius of a ball.
    edges_m : ndarray, shape (3,), or None
        Edges of a box, along its own axes.
    rotation : ndarray, shape (3, 3)
        Columns are a box's axes.
    """

    material: Material
    centre_m: FloatArray
    radius_m: float | None
    edges_m: FloatArray | None
    rotation: FloatArray

    def responses(self, frequency_Hz: FloatArray) -> list[Response]:
        """Return the model of the conductor at each of several frequencies.

        Raises
        ------
        UserError
            It is permeable and its skin is not thin at one of them.
        """
        half = self.radius_m if self.edges_m is None else 0.5 * float(self.edges_m.min())
        assert half is not None
        bodies = {pieces: self.body(pieces) for pieces in (SKIN_PIECES, VOLUME_PIECES)}
        thin = [half > SKIN_RATIO * self.material.skin_depth_m(f) for f in frequency_Hz.tolist()]
        return [
            respond(bodies[SKIN_PIECES if skin else VOLUME_PIECES], f)
            for f, skin in zip(frequency_Hz.tolist(), thin, strict=True)
        ]

    def body(self, pieces: int) -> Body:
        """Return its surface, each edge in so many pieces."""
        if self.edges_m is None:
            assert self.radius_m is not None
            return ball(self.centre_m, self.radius_m, self.material, pieces)
        box = cuboid(np.zeros(3), self.edges_m, self.material, pieces)
        return dataclasses.replace(box, centre_m=self.centre_m, corner_m=self.centre_m + box.corner_m @ self.rotation.T)

    def distance_m(self) -> float:
        """Distance of the sensor from the surface; not above zero inside."""
        if self.edges_m is None:
            assert self.radius_m is not None
            return float(np.linalg.norm(self.centre_m)) - self.radius_m
        beyond = np.abs(self.rotation.T @ self.centre_m) - 0.5 * self.edges_m
        return float(np.linalg.norm(np.maximum(beyond, 0.0)) + min(float(beyond.max()), 0.0))


def load(path: str | Path) -> tuple[Conductor, ...]:
    """Read a file of conductors (TOML).

    Each ``[[conductor]]`` has ``shape`` ("ball" or "box"), ``centre_m``, ``conductivity_S_m`` and may have
    ``relative_permeability`` (default 1); a ball ``radius_m``, a box ``edges_m`` along its own axes and, if these are
    not the sensor's, ``rotation_vector_rad`` from its axes to the sensor's.

    Raises
    ------
    UserError
        If anything is wrong; the sentence names file, line, table and key.
    """
    path = Path(path)
    document = read_table(path, "file of conductors")
    document.allow("conductor")
    return tuple(_conductor(table) for table in document.tables("conductor"))


def _conductor(table: Table) -> Conductor:
    shape = table.text("shape")
    if shape not in KEYS:
        raise table.error("shape", f'is "{shape}"; shapes are {" and ".join(KEYS)}')
    table.allow("shape", "centre_m", "conductivity_S_m", "relative_permeability", *KEYS[shape])
    permeability = table.number("relative_permeability") if "relative_permeability" in table else 1.0
    if permeability < 1.0:
        raise table.error("relative_permeability", f"is {permeability:g}; it must be at least 1")
    turn = table.vector("rotation_vector_rad") if "rotation_vector_rad" in table else np.zeros(3)
    conductor = Conductor(
        Material(table.positive("conductivity_S_m"), permeability),
        table.vector("centre_m"),
        table.positive("radius_m") if shape == "ball" else None,
        _edges(table) if shape == "box" else None,
        np.asarray(Rotation.from_rotvec(turn).as_matrix()),
    )
    length = 2.0 * conductor.radius_m if conductor.radius_m else float(np.max(_edges(table)))
    if conductor.distance_m() < length / VOLUME_PIECES:
        raise table.error(
            "centre_m",
            f"puts the sensor {conductor.distance_m():.3g} m outside the surface; the model holds from a sixth of the "
            f"body's length on, {length / VOLUME_PIECES:.2g} m",
        )
    return conductor


def _edges(table: Table) -> FloatArray:
    edges = table.vector("edges_m")
    if not (edges > 0.0).all():
        raise table.error("edges_m", "must be three lengths greater than zero")
    if edges.max() > FLATTEST * edges.min():
        raise table.error(
            "edges_m",
            f"are longer than {FLATTEST:g} times the shortest: of such a flat or long box no model is known here",
        )
    return edges

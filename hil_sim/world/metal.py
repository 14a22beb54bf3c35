"""Metal among coils: bodies that answer to a coil's field with currents of their own, in one system of equations.

A body is described by unit sources, whose strengths are unknown, and by conditions: places and directions in which the
whole field must vanish. The strengths follow from A x = -b, where b is the coil's field in the conditions and A x that
of the sources themselves; a body with more conditions than sources meets them as well as it can. All bodies are in one
system, so that each feels the others. The earth's field passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Source(Protocol):
    """Anything with a field in proportion to one current."""

    def field_per_ampere(self, positions_m: FloatArray) -> FloatArray:
        """Return B of one ampere, shape (n, 3), tesla, site's frame, at positions of shape (n, 3)."""
        ...


class Body(Protocol):
    """A piece of metal."""

    def fields(self, positions_m: FloatArray) -> FloatArray:
        """Return B of each of the body's unit sources at positions of shape (n, 3): shape (sources, n, 3), tesla."""
        ...

    def conditions(self) -> tuple[FloatArray, FloatArray]:
        """Return the places, shape (m, 3), metres, and the unit vectors along which the field vanishes there."""
        ...


class Metal:
    """All bodies together.

    Parameters
    ----------
    bodies : sequence of Body
        At least one.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self._bodies = bodies
        conditions = [body.conditions() for body in bodies]
        self._places_m = np.concatenate([places for places, _ in conditions])
        self._directions = np.concatenate([directions for _, directions in conditions])
        self._asked: tuple[FloatArray, FloatArray] | None = None
        system = np.einsum("jic,ic->ij", self._fields(self._places_m), self._directions)
        size = np.linalg.norm(system, axis=0)  # loops and dipoles have no common unit
        self._inverse = np.linalg.pinv(system / size, rcond=1e-12) / size[:, None]

    def strengths(self, source: Source) -> FloatArray:
        """Return the strength of each unit source for one ampere in a coil."""
        field = (source.field_per_ampere(self._places_m) * self._directions).sum(axis=1)
        return np.asarray(-self._inverse @ field)

    def field(self, strengths: FloatArray, positions_m: FloatArray) -> FloatArray:
        """Return B, shape (n, 3), tesla, of sources of these strengths."""
        return np.asarray(np.einsum("j,jnc->nc", strengths, self._fields(positions_m)))

    def _fields(self, positions_m: FloatArray) -> FloatArray:
        """Return B of each unit source at each position, shape (sources, n, 3).

        The coils of a bench ask one after the other for the same positions: the last answer is kept.
        """
        if self._asked is None or not np.array_equal(self._asked[0], positions_m):
            self._asked = (positions_m.copy(), np.concatenate([body.fields(positions_m) for body in self._bodies]))
        return self._asked[1]


class BesideMetal:
    """A source and what the metal beside it adds to its field."""

    def __init__(self, source: Source, metal: Metal) -> None:
        self._source, self._metal = source, metal
        self._strengths = metal.strengths(source)

    def field_per_ampere(self, positions_m: FloatArray) -> FloatArray:
        """See `Source.field_per_ampere`."""
        added = self._metal.field(self._strengths, positions_m)
        return np.asarray(self._source.field_per_ampere(positions_m) + added)

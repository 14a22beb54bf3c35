"""Sheets of metal beside coils, against images and a published polarisability."""

from __future__ import annotations

from dataclasses import dataclass

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil_sim.world.metal import BesideMetal, Metal
from hil_sim.world.path import CoilGeometry
from hil_sim.world.sheet import Sheet

UP = np.array([0.0, 0.0, 1.0])
TILTED = np.array([0.6, 0.0, 0.8])
MU_0 = 1.25663706127e-6


@dataclass
class Uniform:
    """A source far away: its field per ampere is the same everywhere."""

    field_T: np.ndarray

    def field_per_ampere(self, positions_m):
        return np.tile(self.field_T, (len(positions_m), 1))


def moment(sheet, source):
    """Magnetic moment of what a source induces in a sheet, from its field far away on the axis."""
    far_m = 100.0 * sheet.side_m
    metal = Metal([sheet])
    field = metal.field(metal.strengths(source), (sheet.centre_m + far_m * sheet.normal)[None, :])[0]
    return field * 2.0 * np.pi * far_m**3 / MU_0


@pytest.mark.parametrize("normal", [UP, TILTED])
def test_moment_in_a_uniform_field_is_the_published_one_of_a_square_plate(normal):
    """0.455 side^3 H against the field: four times the electric polarisability 0.1137 of a square hole (duality)."""
    sheet = Sheet(np.array([1.0, 2.0, 3.0]), normal, 0.4)
    induced = moment(sheet, Uniform(MU_0 * normal))
    np.testing.assert_allclose(induced, -4.0 * 0.1137 * 0.4**3 * normal, rtol=0.015, atol=1e-5)


def test_a_field_along_the_sheet_induces_nothing():
    sheet = Sheet(np.zeros(3), TILTED, 0.4)
    assert np.abs(moment(sheet, Uniform(MU_0 * np.array([0.8, 0.0, -0.6])))).max() < 1e-9


def test_near_a_large_sheet_the_coil_has_an_image():
    """Between a coil and a sheet much larger than their distance the field is that of the coil and its reflection."""
    centre, turn = np.array([0.0, 0.0, 0.15]), Rotation.from_rotvec([0.3, 0.0, 0.0])
    coil = CoilGeometry(turns=5.0, radius_m=0.08, position_m=centre, axis=turn.apply(UP))
    reflected = centre * [1.0, 1.0, -1.0]
    # A current loop is reflected like a pseudo-vector, and the image has the opposite current.
    axis = coil.axis * [1.0, 1.0, -1.0]
    image = CoilGeometry(turns=5.0, radius_m=0.08, position_m=reflected, axis=axis)
    beside = BesideMetal(coil, Metal([Sheet(np.zeros(3), UP, 1.6)]))
    points = np.array([[0.0, 0.0, 0.3], [0.1, 0.05, 0.25], [-0.2, 0.1, 0.4]])
    expected = coil.field_per_ampere(points) + image.field_per_ampere(points)
    added = expected - coil.field_per_ampere(points)
    error = np.linalg.norm(beside.field_per_ampere(points) - expected, axis=1)
    assert np.all(error < 0.05 * np.linalg.norm(added, axis=1))


def test_two_sheets_feel_each_other():
    """Two sheets one on the other shield like one, not like two."""
    one = Sheet(np.zeros(3), UP, 0.4)
    near = Sheet(np.array([0.0, 0.0, 0.02]), UP, 0.4)
    coil = CoilGeometry(turns=1.0, radius_m=0.1, position_m=np.array([0.0, 0.0, 0.5]), axis=UP)
    point = np.array([[0.0, 0.0, -0.5]])
    alone = coil.field_per_ampere(point)[0, 2]
    added = [BesideMetal(coil, Metal(sheets)).field_per_ampere(point)[0, 2] - alone for sheets in ([one], [one, near])]
    assert added[1] / added[0] == pytest.approx(1.0, abs=0.15)


def test_the_field_on_the_far_side_is_less():
    coil = magpylib.current.Circle(current=1.0, diameter=0.2, position=(0.0, 0.0, 0.1))
    own = CoilGeometry(turns=1.0, radius_m=0.1, position_m=np.array([0.0, 0.0, 0.1]), axis=UP)
    behind = np.array([[0.0, 0.0, -0.1]])
    beside = BesideMetal(own, Metal([Sheet(np.zeros(3), UP, 0.8)]))
    assert np.linalg.norm(beside.field_per_ampere(behind)) < 0.25 * np.linalg.norm(coil.getB(behind))

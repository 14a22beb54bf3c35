"""The figures that the locator must reach, in full: `python -m tests.bench.locate_figures` prints them."""

from __future__ import annotations

import pytest

from tests.bench import locate_figures

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


def test_cube_and_larger_volumes():
    for (noise, size), figures in locate_figures.cube().items():
        assert figures["failures"] == 0, (noise, size)
        assert figures["rms_error_over_bound"] <= 1.05
        assert 0.8 <= figures["normalised_error_position"] <= 1.3
        assert 0.8 <= figures["normalised_error_attitude"] <= 1.3


def test_lattice_and_its_mirror():
    result = locate_figures.lattice()
    assert result[True]["failures"] < 10
    assert result[True]["rms_error_over_bound"] <= 1.1
    assert "ambiguous" not in result[True]["status"]
    assert result[False]["mirror_reported"] == result[False]["poses"]


def test_board_of_spiral_coils_and_one_axis():
    figures = locate_figures.board()
    assert figures["failures"] == 0
    assert figures["rms_error_over_bound"] <= 1.1


def test_ours_against_the_steps_of_the_sources():
    table = locate_figures.steps()
    assert table["simple magnitudes"]["median_cm"] > table["full magnitudes"]["median_cm"] > table["ours"]["median_cm"]
    assert table["ours"]["within_8_bounds_percent"] == 100.0


def test_faults():
    result = locate_figures.faults()
    for kind in locate_figures.bench.FAULTS:
        assert result[kind]["detected_of_these_percent"] >= 99.0, kind
        assert result[kind]["error_after_exclusion_over_7_beacon_bound"] <= 1.2, kind
    assert result["false alarms"]["alarms"] <= result["false alarms"]["epochs"] / 1000

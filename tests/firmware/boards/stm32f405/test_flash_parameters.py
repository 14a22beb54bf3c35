"""``make flash`` takes every parameter of a board, and nothing that the board would refuse."""

import subprocess

import pytest

from goldfield_protocol.parameters import PARAMETERS, parse_page
from hil_sim.clib import ROOT


def value_of(parameter):
    """The parameter's maximum, as it is written on make's command line."""
    elements = parameter.count if parameter.exact else parameter.group
    return ",".join([str(parameter.high)] * elements)


@pytest.fixture
def flash(tmp_path):
    """Run ``make flash`` with a program in place of pyOCD that writes down its arguments, and the images as built."""
    probe, told, page = tmp_path / "pyocd", tmp_path / "told", tmp_path / "page.bin"
    probe.write_text(f'#!/bin/sh\necho "$@" >>"{told}"\necho STM32F4xx_DFP\n')
    probe.chmod(0o755)

    def run(*assignments):
        own = [f"PYOCD={probe}", f"STM32_PAGE={page}", "-o", "firmware"]
        done = subprocess.run(
            ["make", "-s", "flash", *own, *assignments], cwd=ROOT, capture_output=True, text=True, check=False
        )
        loaded = told.read_text().splitlines()[-1] if told.exists() else ""
        return done, loaded, page

    return run


def test_every_parameter_can_be_flashed(flash):
    assignments = [f"{name.upper()}={value_of(p)}" for name, p in PARAMETERS.items()]
    done, loaded, page = flash("ROLE=anchor", *assignments)
    assert done.returncode == 0, done.stderr
    assert loaded == f"load --target stm32f405rgtx build/firmware/anchor.elf {page}@0x080E0000"
    stored = parse_page(page.read_bytes())
    assert set(stored) == set(PARAMETERS)
    assert stored["node"] == 4095
    assert stored["codes"] == [2048] * 4


def test_what_a_board_refuses_is_not_flashed(flash):
    done, loaded, page = flash("ROLE=beacon", "NODE=3", "AMPLITUDE=100")
    assert done.returncode == 2
    assert "error: amplitude is 100 A; it must be 0 to 15.9 A" in done.stderr
    assert not loaded
    assert not page.exists()


def test_parameters_need_the_node(flash):
    done, loaded, _ = flash("ROLE=beacon", "AMPLITUDE=10")
    assert done.returncode == 2
    assert "needs NODE=n as well" in done.stdout
    assert not loaded


def test_an_image_alone_leaves_the_page(flash):
    done, loaded, page = flash("ROLE=sensor")
    assert done.returncode == 0, done.stderr
    assert loaded == "load --target stm32f405rgtx build/firmware/sensor.elf"
    assert not page.exists()


def test_a_mistyped_parameter_is_refused(flash):
    done, loaded, page = flash("ROLE=beacon", "NODE=3", "AMPLITUD=10")
    assert done.returncode == 2
    assert "error: there is no parameter 'amplitud'; the nearest is 'amplitude'" in done.stderr
    assert not loaded
    assert not page.exists()

"""``make flash`` takes every parameter of a board, and nothing that the board would refuse; a probe comes first."""

import json
import subprocess

import pytest

from goldfield_protocol.parameters import PARAMETERS, parse_page
from hil_sim.clib import ROOT


def value_of(parameter):
    """The parameter's maximum, as it is written on make's command line."""
    elements = parameter.count if parameter.exact else parameter.group
    return ",".join([str(parameter.high)] * elements)


def probes(*unique_ids, **more):
    """What ``pyocd json --probes`` prints."""
    boards = [{"unique_id": unique_id, "info": f"STM32 STLink {unique_id}"} for unique_id in unique_ids]
    return json.dumps({"pyocd_version": "0.46.0", "status": 0, "boards": boards} | more)


ONE_PROBE = probes("066DFF01")


@pytest.fixture
def flash(tmp_path):
    """Run ``make flash`` with a program in place of pyOCD that writes down its arguments, and the images as built."""
    probe, told, page, listed = (tmp_path / name for name in ("pyocd", "told", "page.bin", "probes.json"))
    probe.write_text(f'#!/bin/sh\n[ "$1" = json ] && exec cat "{listed}"\necho "$@" >>"{told}"\necho STM32F4xx_DFP\n')
    probe.chmod(0o755)

    def run(*assignments, probes=ONE_PROBE):
        listed.write_text(probes)
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


NOT_FLASHED = [
    (
        probes(),
        (),
        "no debug probe was found: connect one by USB (an ST-LINK, a J-Link or any CMSIS-DAP); one that is c",
    ),
    (ONE_PROBE, ("PROBE=0770",), "there is no debug probe 0770: give one of PROBE=066DFF01 (STM32 STLink 066DFF01)"),
    (probes("066DFF01", "066DFF02"), ("PROBE=066D",), "2 debug probes are connected: give one of PROBE=066DFF01 ("),
    (probes("066DFF01", "066DFF02"), (), "2 debug probes are connected: give one of PROBE=066DFF01 (STM32 STLink 066"),
    (probes(status=1, error="no USB\nhere"), (), "the search for a debug probe failed: no USB here: plug the probe in"),
    ("Traceback", (), "json --probes: does not list the debug probes: run it to see why"),
    ("[]", (), "json --probes: does not list the debug probes: run it to see why"),
    (
        ONE_PROBE,
        ("PYOCD=no/such/pyocd",),
        "no/such/pyocd: No such file or directory: pyOCD programs boards, and make set",
    ),
]


@pytest.mark.parametrize(("listed", "assignments", "sentence"), NOT_FLASHED)
def test_no_probe_is_told_before_anything_is_built_or_flashed(flash, listed, assignments, sentence):
    done, loaded, page = flash("ROLE=beacon", "NODE=3", *assignments, probes=listed)
    assert done.returncode == 2
    told, make = done.stderr.splitlines()
    assert sentence in told
    assert "flash-ready" in make
    assert not loaded
    assert not page.exists()


def test_the_probe_is_named_and_the_one_of_several_used(flash):
    done, loaded, _ = flash("ROLE=sensor")
    assert done.stdout.splitlines()[0] == "debug probe: STM32 STLink 066DFF01, 066DFF01"
    done, loaded, _ = flash("ROLE=sensor", "PROBE=FF02", probes=probes("066DFF01", "066DFF02"))
    assert done.stdout.splitlines()[0] == "debug probe: STM32 STLink 066DFF02, 066DFF02"
    assert loaded == "load --uid FF02 --target stm32f405rgtx build/firmware/sensor.elf"

"""The pages on site files, scenarios and the command line name every key and option, the first two no other key."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from goldfield.site import board_keys, drive, metal_keys
from goldfield.site import reading as site_reading
from hil_sim.clib import ROOT
from hil_sim.scenario import bodies, events, installation, motions, reading, surroundings


def documented(page: str) -> set[str]:
    """Keys in the first column of the page's tables that have a unit and a default."""
    keys: set[str] = set()
    for table in re.findall(r"^\| key \| unit .*\n((?:\|.*\n)+)", (ROOT / "docs" / page).read_text(), re.M):
        for row in table.splitlines()[1:]:
            keys |= set(re.findall(r"`\[?\[?([\w.]+)\]?\]?`", row.split("|")[1]))
    return keys


def test_every_key_of_a_site_file_is_explained() -> None:
    site = {"name", "half_space", "access", "chip_period_s", "degree", "shared_codes"}
    site |= {*site_reading.LIMITS, *drive.SITE_KEYS}
    keys = site | {*site_reading.SENSOR_KEYS, *site_reading.SURVEY_LIMITS}
    keys |= {*site_reading.BEACON_KEYS, *site_reading.SHAPE_KEYS, *site_reading.DRIVE_KEYS, metal_keys.BEACON_KEY}
    keys |= {*board_keys.BOARD_KEYS}
    keys |= {*metal_keys.KEYS} - {"body"} | {"metal.body"}
    assert documented("site_file.md") == keys


def test_every_key_of_a_scenario_is_explained() -> None:
    top = {"name", "seed", "degree", "power_on_spread_s", "slots", "sync", "half_space", "shared_codes"}
    ambient = {"earth_T", "mains", "impulses"}
    keys = top | ambient | {*reading.SENSOR_KEYS, *reading.BEACON_KEYS, *reading.COIL_KEYS, *reading.CLOCK_KEYS}
    keys |= {
        *reading.CAN_KEYS,
        *reading.LINKS_RATES,
        *events.EVENT_KEYS,
        *installation.INSTALLATION_KEYS,
        *motions.KNOWN_POINT_KEYS,
    }
    keys |= {"shape", *surroundings.MAGNET_KEYS}.union(*bodies.METAL_KEYS.values())
    keys = keys - {"sensor"} | {"beacon.sensor"}
    assert documented("scenario.md") == keys


def test_every_motion_and_every_sheet_is_explained() -> None:
    text = (ROOT / "docs/scenario.md").read_text()
    assert all(re.search(rf"\b{key}\b", text) for key in bodies.SHEET_KEYS)
    for kind, keys in motions.MOTION_KEYS.items():
        assert f'`"{kind}"`' in text
        assert all(f"`{key}`" in text for key in keys)


COMMANDS = ("run", "locate", "separate", "samples", "survey", "hil")


def options_of(command: str) -> set[str]:
    """Return the long options of a subcommand."""
    help_text = subprocess.run(
        [sys.executable, "-m", "goldfield", command, "--help"], capture_output=True, text=True, check=True
    ).stdout
    return set(re.findall(r"^  (?:-h, )?(--[a-z][a-z-]*)", help_text, re.M)) - {"--help"}


def section(command: str) -> str:
    """Return what the page on the command line says of a subcommand: its row, its section, and the JSON lines."""
    text = (ROOT / "docs/cli.md").read_text()
    row = "".join(re.findall(rf"^\| `goldfield {command} .*\n", text, re.M))
    parts = re.split(r"^##+ (.*)\n", text, flags=re.M)
    titled = dict(zip(parts[1::2], parts[2::2], strict=True))
    return row + "".join(body for title, body in titled.items() if command in title.split()) + titled["JSON lines"]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_is_on_the_page_of_the_command_line(command: str) -> None:
    found = options_of(command)
    assert "--site" in found
    assert {option for option in found if option not in section(command)} == set()


def test_the_page_is_read_by_sections() -> None:
    assert "--pace" in section("hil")
    assert "--pace" not in section("run")

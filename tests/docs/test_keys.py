"""The pages on site files and scenarios name every key that the readers take, and no other."""

from __future__ import annotations

import re

from goldfield.site import drive
from goldfield.site import reading as site_reading
from hil_sim.clib import ROOT
from hil_sim.scenario import reading


def documented(page: str) -> set[str]:
    """Keys in the first column of the page's tables that have a unit and a default."""
    keys: set[str] = set()
    for table in re.findall(r"^\| key \| unit .*\n((?:\|.*\n)+)", (ROOT / "docs" / page).read_text(), re.M):
        for row in table.splitlines()[1:]:
            keys |= set(re.findall(r"`\[?\[?([\w.]+)\]?\]?`", row.split("|")[1]))
    return keys


def test_every_key_of_a_site_file_is_explained() -> None:
    site = {"name", "half_space", "access", "chip_period_s", "degree", *drive.SITE_KEYS}
    keys = site | {"noise_T", "model_error"} | {*site_reading.BEACON_KEYS, *site_reading.DRIVE_KEYS}
    assert documented("site_file.md") == keys


def test_every_key_of_a_scenario_is_explained() -> None:
    top = {"name", "seed", "degree", "power_on_spread_s", "slots", "sync", "half_space"}
    ambient = {"earth_T", "mains", "impulses"}
    keys = top | ambient | {*reading.SENSOR_KEYS, *reading.BEACON_KEYS, *reading.COIL_KEYS, *reading.CLOCK_KEYS}
    keys = keys - {"sensor"} | {"beacon.sensor"}
    assert documented("scenario.md") == keys


def test_every_motion_is_explained() -> None:
    text = (ROOT / "docs/scenario.md").read_text()
    for kind, keys in reading.MOTION_KEYS.items():
        assert f'`"{kind}"`' in text
        assert all(f"`{key}`" in text for key in keys)

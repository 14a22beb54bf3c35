"""Scenarios of the simulator: one whose site file can be read again, or one sentence."""

from __future__ import annotations

from goldfield.site import load as load_site
from hil_sim.scenario.reading import load
from hil_sim.scenario.site_file import site_toml
from tests.fuzz.host.judging import answered, written

MOST_BYTES = 8_000


def one_input(data: bytes) -> None:
    """Read one scenario, and the site file that is made of it."""
    path = written(data[:MOST_BYTES], ".toml")
    scenario = answered(lambda: load(path))
    if scenario is None:
        return
    assert scenario.beacons is not None
    text = answered(lambda: site_toml(scenario))
    if text is not None:
        answered(lambda: load_site(written(text.encode(), ".site.toml")))

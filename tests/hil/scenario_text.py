"""Scenarios that a test or a bench writes itself."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hil_sim.scenario import Scenario
from hil_sim.scenario import load as load_scenario


def scenario_of(text: str) -> Scenario:
    """Return the scenario that a text describes, as `hil_sim.scenario.load` reads it of a file."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "scenario.toml"
        path.write_text(text, encoding="utf-8")
        return load_scenario(path)

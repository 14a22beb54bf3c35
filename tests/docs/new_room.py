"""The commands of docs/new_room.md: what the page tells a reader to copy and to change is done before they run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hil_sim.clib import ROOT
from tests.docs import walkthrough

PAGE = "new_room.md"
SENSOR = "goldfield hil turning8 --boards host --site turning.toml --true-site turning_true.toml --link ./sensor --wait"
"""The first command behind those of the survey: calibration and metal follow, which take most of the time."""


def run_new_room(
    folder: Path, tell: Callable[[str], None] = lambda _: None, until: str | None = None
) -> list[walkthrough.Step]:
    """Run all commands of the page, or those in front of one, with the scenario of its last part made before.

    The folder is empty.
    """
    scenario = (ROOT / "hil_sim/scenarios/walk8.toml").read_text(encoding="utf-8")
    quiet = scenario.replace("\nnoise_T = 2.0e-7 ", "\nnoise_T = 2.0e-8 ")
    if quiet == scenario:
        raise RuntimeError("walk8.toml has no noise_T = 2.0e-7, which the page changes")
    text = quiet + "\n" + "\n".join(walkthrough.blocks(PAGE, "toml"))
    (folder / "metal_room.toml").write_text(text, encoding="utf-8")
    return walkthrough.run_page(PAGE, folder, tell, until)

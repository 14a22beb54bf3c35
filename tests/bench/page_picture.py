"""Draws docs/live_page.png: the live page of a sensor that walks among eight beacons, of which one fails."""

from __future__ import annotations

import tempfile
from pathlib import Path

from playwright.sync_api import expect

from hil_sim.clib import ROOT
from tests.host.page.browser import DESKTOP, Served, chromium, recorded
from tests.host.page.walk import walk

PICTURE = ROOT / "docs/live_page.png"
CYCLES = 125
"""The coil opens in cycle 90."""


def main() -> None:
    """Draw the picture."""
    with tempfile.TemporaryDirectory() as directory:
        log = Path(directory) / "walk.log"
        log.write_text(walk(CYCLES))
        messages = recorded(log)
    with chromium() as browser, Served() as served:
        page = browser.new_page(viewport=DESKTOP, color_scheme="light")
        page.goto(served.url)
        served.publish(messages[:-20])
        page.wait_for_timeout(1500)  # three dimensions without a graphics card take their time
        served.publish(messages[-20:])
        expect(page.locator("#link-word")).to_have_text("live")
        expect(page.get_by_label("What is wrong now")).to_contain_text("open coil")
        page.wait_for_timeout(1000)
        page.screenshot(path=PICTURE)
    print(f"{PICTURE.relative_to(ROOT)}: {PICTURE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()

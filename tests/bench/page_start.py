"""Print how long it takes from the start of ``goldfield view`` to the first pose in the browser, and of what.

``python -m tests.bench.page_start [--turns N]``. Simulated boards that are compiled for this machine send as fast as
real ones; the browser is running already. Python keeps its bytecode, as where a wheel is installed: a first turn, which
makes it, does not count. Beside the times by the clock, which depend on what else the machine does,
stands the processor time that the command has used until then.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from playwright.sync_api import expect

from tests.bench.command_costs import GOLDFIELD
from tests.command import whole_number
from tests.host.page.browser import chromium

STAGES = ("address printed", "page loaded", "first pose shown", "processor time")


def with_bytecode(folder: str) -> dict[str, str]:
    """Return this program's environment with a folder in which Python keeps its bytecode."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPYCACHEPREFIX": folder}


def turn(browser, port: str, site: str, environment: dict[str, str]) -> tuple[float, ...]:
    """Start the command once; return the times of `STAGES` after its start, s."""
    context = browser.new_context()
    page = context.new_page()
    begun_s = time.monotonic()
    words = ["view", "--port", port, "--site", site, "--bind", "127.0.0.1:0"]
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    view = subprocess.Popen([*GOLDFIELD, *words], env=environment, **quiet)
    try:
        url = view.stdout.readline().strip()
        times = [time.monotonic() - begun_s]
        page.goto(url)
        times.append(time.monotonic() - begun_s)
        expect(page.locator("#status-word")).not_to_have_text("no pose yet", timeout=60_000)
        times.append(time.monotonic() - begun_s)
        fields = Path(f"/proc/{view.pid}/stat").read_text().rpartition(")")[2].split()
        times.append((int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"))
    finally:
        view.terminate()
        view.communicate()
        context.close()
    return tuple(times)


def main() -> None:
    """Print the median and the worst of several turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=whole_number(1), default=10)
    turns = parser.parse_args().turns
    with tempfile.TemporaryDirectory() as name, chromium() as browser:
        site, said = f"{name}/site.toml", Path(name) / "bench.jsonl"
        words = ["hil", "prigge8", "--boards", "host", "--can", "none", "--json", "--site", site]
        with said.open("w") as file:
            bench = subprocess.Popen([*GOLDFIELD, *words], stdout=file, stderr=subprocess.DEVNULL)
        try:
            while "\n" not in (text := said.read_text()):
                time.sleep(0.1)
            port = json.loads(text.partition("\n")[0])["serial"]
            environment = with_bytecode(f"{name}/bytecode")
            seen = [turn(browser, port, site, environment) for _ in range(1 + turns)][1:]
        finally:
            bench.kill()
            bench.wait()
    print(f"load of this machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; {turns} turns")
    for stage, times in zip(STAGES, zip(*seen, strict=True), strict=True):
        print(f"{stage:<18} {statistics.median(times):5.2f} s in the median, {max(times):5.2f} s at most")


if __name__ == "__main__":
    main()

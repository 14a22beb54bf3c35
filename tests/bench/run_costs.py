"""Print what ``goldfield run`` costs in processor time and memory, at 10 to 330 Hz, without the live page and with it.

``python -m tests.bench.run_costs [--seconds N] [--turns N] [--rates 10 100 330]``. Simulated boards, compiled for this
machine, are recorded for so long with what a sensor sends for that rate: at 10 Hz a field of each beacon and cycle,
above that blocks of chips. The recording is read again, once a quarter of it and once all of it, so that the difference
is what a second of the sensor costs, whatever else the machine does meanwhile. It is printed as a share of one core;
memory is the peak of either run, shared libraries included, which tells whether it grows.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

from tests.bench.command_costs import GOLDFIELD, cost, least
from tests.command import one_of, real_number, whole_number

RATES: dict[str, list[str]] = {"10": [], "100": ["--rate", "100"], "330": ["--rate", "330"]}
PAGES: dict[str, list[str]] = {"no": [], "yes": ["--view", "127.0.0.1:0"]}
SHARE = 0.25


def record(folder: Path, seconds: float, rate: list[str]) -> Path:
    """Record a sensor that sends what a rate needs; return the recording, beside which is site.toml."""
    site, log = folder / "site.toml", folder / "all.log"
    words = ["hil", "prigge8", "--boards", "host", "--pace", "0", "--can", "none", "--json", "--site", str(site)]
    words += ["--force", "--truth", str(folder / "truth.jsonl")]  # not to a pipe that nobody reads
    bench = subprocess.Popen([*GOLDFIELD, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert bench.stdout is not None
        port = json.loads(bench.stdout.readline())["serial"]
        words = ["run", "--port", port, "--site", str(site), *rate, "--seconds", str(seconds)]
        cost([*GOLDFIELD, *words, "--record", str(log), "--force"])
    finally:
        bench.terminate()
        bench.communicate()
    return log


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=real_number(1.0), default=40.0, help="length of the recording")
    parser.add_argument("--turns", type=whole_number(1), default=2, help="runs of each, of which the least time counts")
    parser.add_argument("--rates", nargs="+", type=one_of(RATES), default=list(RATES), help="of them (default: all)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        part = Path(name) / "part.log"
        print("rate Hz  page   % of one core   peak MB, a quarter   peak MB, all")
        for rate in arguments.rates:
            words = RATES[rate]
            log = record(Path(name), arguments.seconds, words)
            lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
            part.write_text("".join(lines[: int(len(lines) * SHARE)]), encoding="utf-8")
            for page, more in PAGES.items():
                run = [*GOLDFIELD, "run", "--site", f"{name}/site.toml", "--json", *words, *more, "--log"]
                short, long = (least([*run, str(path)], arguments.turns) for path in (part, log))
                share = (long.processor_s - short.processor_s) / (arguments.seconds * (1.0 - SHARE))
                memory = "".join(f"{used.peak_bytes / 1e6:>{width}.0f}" for used, width in ((short, 21), (long, 15)))
                print(f"{rate:>7}  {page:<4}{100.0 * share:>16.1f}{memory}", flush=True)


if __name__ == "__main__":
    main()

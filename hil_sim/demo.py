"""The main job: eight emulated beacons and a sensor, and the host's command line on the sensor's serial port.

``python -m hil_sim.demo`` starts the rig as one process and ``goldfield run`` as another: they meet only at a
pseudo-terminal, as a board and a host would. The truth of the simulated world goes beside, in a file.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from goldfield.cli.entry import Parser
from goldfield.cli.options import seconds
from hil_sim.scenario import load_scenario, site_toml

START_SECONDS = 3.0
"""Virtual time the boards get to boot, synchronise and ramp their currents up, beyond the seconds asked for."""


def main(argv: list[str] | None = None) -> int:
    """Run the demonstration; returns the exit code of the part that failed, or 0."""
    parser = Parser(prog="python -m hil_sim.demo", description=__doc__)
    parser.add_argument("--scenario", default="prigge8")
    parser.add_argument("--seconds", type=seconds, default=20.0, help="virtual seconds of poses (default 20)")
    parser.add_argument("--boards", choices=("emulated", "host"), default="emulated")
    options = parser.parse_args(argv)

    with tempfile.TemporaryDirectory(prefix="goldfield-") as directory:
        truth, site = Path(directory) / "truth.jsonl", Path(directory) / "site.toml"
        site.write_text(site_toml(load_scenario(options.scenario)))
        rig_command = ["hil", options.scenario, "--json", "--boards", options.boards, "--truth", str(truth)]
        print(f"starting {options.scenario} with {options.boards} boards ...", flush=True)
        with subprocess.Popen(
            [sys.executable, "-m", "goldfield", *rig_command, "--seconds", str(options.seconds + START_SECONDS + 60.0)],
            stdout=subprocess.PIPE,
            text=True,
        ) as rig:
            try:
                assert rig.stdout is not None
                first = rig.stdout.readline()
                if not first:
                    return rig.wait() or 3
                links = json.loads(first)
                print(f"sensor on {links['serial']}", flush=True)
                run = ["run", "--port", links["serial"], "--site", str(site), "--truth", str(truth)]
                return subprocess.call(
                    [sys.executable, "-m", "goldfield", *run, "--seconds", str(options.seconds)],
                )
            except KeyboardInterrupt:
                return 0
            finally:
                stop(rig)


def stop(process: subprocess.Popen[str]) -> None:
    """End the rig: politely, then for good."""
    process.terminate()
    deadline = time.monotonic() + 5.0
    while process.poll() is None and time.monotonic() < deadline:
        try:
            process.communicate(timeout=0.2)
        except subprocess.TimeoutExpired:
            continue
    if process.poll() is None:
        process.kill()


if __name__ == "__main__":
    sys.exit(main())

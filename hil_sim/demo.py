"""The main job: eight emulated beacons and a sensor, and the host's command line on the sensor's serial port.

``python -m hil_sim.demo`` starts the rig as one process and ``goldfield run`` as another: they meet only at a
pseudo-terminal, as a board and a host would. The truth of the simulated world goes beside, in a file.

However slow the machine is, poses come at last: no part waits by the wall clock. The rig's time stands still until its
port is read, the host waits for a sensor that is not heard yet, and what bounds all this is the rig's own end in
virtual time.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from goldfield.cli.entry import Parser
from goldfield.cli.options import seconds
from goldfield.errors import EXIT_FAILED, tell
from hil_sim.scenario import load_scenario, site_toml

PROGRAM = (sys.executable, "-m", "goldfield")
START_SECONDS = 3.0
"""Virtual time the boards get to boot, synchronise and ramp their currents up, beyond the seconds asked for."""
SPARE_SECONDS = 60.0
"""Virtual time beyond that after which a run that still lacks poses has failed."""
LOOK_S = 0.1
"""Wall time between two looks at whether a part has ended."""
LAST_WORDS_S = 10.0
"""Wall time that a run gets to end by itself once the rig has ended; what it then lacks does not come any more."""


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
        rig = ["hil", options.scenario, "--json", "--wait", "--boards", options.boards, "--truth", str(truth)]
        run = ["run", "--reconnect", "--site", str(site), "--truth", str(truth), "--seconds", str(options.seconds)]
        print(f"starting {options.scenario} with {options.boards} boards ...", flush=True)
        until = options.seconds + START_SECONDS + SPARE_SECONDS
        return play([*PROGRAM, *rig, "--seconds", str(until)], [*PROGRAM, *run])


def play(rig_command: Sequence[str], run_command: Sequence[str]) -> int:
    """Start a rig, then what reads its port, until that ends; return the exit code of the part that failed, or 0.

    Parameters
    ----------
    rig_command : sequence of str
        Prints an object of JSON with the key ``serial`` as its first line.
    run_command : sequence of str
        Gets ``--port`` and the port besides. It may wait without end: it is ended if the rig ends before it.
    """
    with subprocess.Popen(rig_command, stdout=subprocess.PIPE, text=True) as rig:
        try:
            assert rig.stdout is not None
            first = rig.stdout.readline()
            if not first:
                return rig.wait() or EXIT_FAILED
            port = json.loads(first)["serial"]
            print(f"sensor on {port}", flush=True)
            with subprocess.Popen([*run_command, "--port", port]) as run:
                try:
                    return _first_end(rig, run)
                finally:
                    stop(run)
        except KeyboardInterrupt:
            return 0
        finally:
            stop(rig)


def _first_end(rig: subprocess.Popen[str], run: subprocess.Popen[bytes]) -> int:
    """Wait until one of two programs has ended, and return the exit code of the whole."""
    while run.poll() is None:
        if rig.poll() is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                return run.wait(LAST_WORDS_S)  # it may have had all that it wanted
            tell("the boards ended before all poses were there", failure=True)
            return rig.returncode or EXIT_FAILED
        time.sleep(LOOK_S)
    return run.returncode


def stop(process: subprocess.Popen[Any]) -> None:
    """End a program that may have ended already: politely, then for good."""
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

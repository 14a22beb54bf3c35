"""Look for the debug probe that programs a board, and say which it is or what to do.

``python -m goldfield.update.find_probe PYOCD [ID]``: the program that programs boards and, where several probes are
connected, a part of the unique id of the one that is meant. Exit code 0: there is exactly one; 2: a sentence on stderr
tells why not.
"""

from __future__ import annotations

import json
import subprocess
import sys

CONNECT = (
    "connect one by USB (an ST-LINK, a J-Link or any CMSIS-DAP); one that is connected needs pyOCD's udev rules "
    "(https://github.com/pyocd/pyOCD/tree/main/udev)"
)


class NoProbe(Exception):
    """The sentence that tells why there is no probe to use."""


def connected(pyocd: str) -> dict[str, str]:
    """Return the names of the connected probes by their unique ids.

    Raises
    ------
    NoProbe
        If the program is not there, or its search fails.
    """
    try:
        told = subprocess.run([pyocd, "json", "--probes"], capture_output=True, text=True, check=False).stdout
    except OSError as error:
        raise NoProbe(f"{pyocd}: {error.strerror}: pyOCD programs boards, and make setup installs it") from error
    try:
        answer = json.loads(told)
        found = {str(probe["unique_id"]): str(probe["info"]) for probe in answer["boards"]}
    except (ValueError, KeyError, TypeError) as error:
        raise NoProbe(f"{pyocd} json --probes: does not list the debug probes: run it to see why") from error
    if answer.get("status"):
        reason = " ".join(str(answer.get("error")).split())
        raise NoProbe(f"the search for a debug probe failed: {reason}: plug the probe in again")
    return found


def choose(probes: dict[str, str], wanted: str) -> str:
    """Return the line that names the one probe whose unique id contains a text.

    Raises
    ------
    NoProbe
        If there is none, or more than one.
    """
    found = {unique_id: name for unique_id, name in probes.items() if wanted in unique_id}
    if len(found) == 1:
        ((unique_id, name),) = found.items()
        return f"debug probe: {name}, {unique_id}"
    listed = ", ".join(f"PROBE={unique_id} ({name})" for unique_id, name in (found or probes).items())
    if found:
        raise NoProbe(f"several debug probes are connected: give one of {listed}")
    if probes:
        raise NoProbe(f"there is no debug probe {wanted}: give one of {listed}")
    raise NoProbe(f"no debug probe was found: {CONNECT}")


def main(pyocd: str, wanted: str = "") -> int:
    """Print a line, and return the exit code."""
    try:
        print(choose(connected(pyocd), wanted), flush=True)
    except NoProbe as sentence:
        print(sentence, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

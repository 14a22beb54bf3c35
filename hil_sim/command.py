"""``goldfield hil``: simulated bench: boards, coils, field and links.

The rig is a process of its own, its serial ports pseudo-terminals, its CAN a python-can bus. The first line is the
command's line in ``goldfield --help``. Also ``python -m hil_sim.command``.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from goldfield.cli import main as goldfield_main
from goldfield.cli.options import add_force
from goldfield.files.outputs import OutputFile, check_outputs, holds, write_file
from hil_sim.links.can_bridge import CanBridge
from hil_sim.links.port_name import PortName
from hil_sim.links.pseudo_terminal import PseudoTerminal
from hil_sim.links.read_command import read_command
from hil_sim.rig import SENSOR, Rig
from hil_sim.rig.boards import KINDS
from hil_sim.scenario import Scenario, load_scenario, site_toml

SLICE_S = 0.005
"""Virtual time between two services of the links."""
PROGRESS_S = 5.0
LONGEST_S = 5e6
"""Virtual time in which a run ends by itself: its picoseconds have 63 bits, which hold 106 days."""
NO_CAN = "none"


def command(subparsers: Any) -> None:
    """Add the subcommand to the command line of goldfield."""
    parser = subparsers.add_parser(
        "hil",
        description="Runs a scenario in one virtual time. The first line tells the serial path and the CAN channel, "
        "with --json those of anchors too, which else have a line each, and the command that reads the sensor; "
        "then one line of truth a cycle (--json) or a line of progress now and then.",
    )
    _add_arguments(parser)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", help="a name in hil_sim/scenarios, or a file")
    seconds = _number(1e-3, LONGEST_S, "number of seconds")
    parser.add_argument("--seconds", type=seconds, metavar="N", help="virtual seconds; default: until interrupted")
    parser.add_argument(
        "--boards",
        choices=KINDS,
        default=KINDS[0],
        help="emulated: they run the ARM image (default)",
    )
    parser.add_argument("--seed", type=_seed, metavar="N", help="in place of the scenario's")
    parser.add_argument("--json", action="store_true", help="JSON lines")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="write the lines of truth there, and only there")
    parser.add_argument("--site", type=Path, metavar="FILE", help=SITE_HELP)
    add_force(parser)
    parser.add_argument("--pace", type=_pace, default=1.0, metavar="X", help=PACE_HELP)
    parser.add_argument("--can", metavar="CHANNEL", default=NO_CAN, help=CAN_HELP)
    parser.add_argument("--link", type=Path, metavar="PATH", help=LINK_HELP)
    parser.set_defaults(run=run)


SITE_HELP = "write the site file of this scenario there; default: a file that is there as long as the bench runs"
CAN_HELP = (
    "own: a CAN channel of this bench alone, for programs of this machine; "
    "INTERFACE:CHANNEL of python-can, as socketcan:vcan0; none (default)"
)
PACE_HELP = (
    "at most X virtual seconds in a second (default 1); 0: as fast as possible, and waiting for the reader of the port"
)
LINK_HELP = "a symbolic link to the serial port while the bench runs; those of anchors have their node added: PATH.NODE"


def _number(least: float, most: float, what: str) -> Callable[[str], float]:
    """Return a parser of numbers between two limits, which are allowed."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"'{text}' is no {what} of {least:g} to {most:.0f}")
        return value

    return parse


def _pace(text: str) -> float:
    """Parse a pace: 0, or a speed at which the bench still does something within seconds."""
    try:
        if float(text) == 0.0:
            return 0.0
    except ValueError:
        pass
    return _number(1e-3, 1e6, "pace: give 0, or a number")(text)


def _seed(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 19 and int(text) < 1 << 63):
        raise argparse.ArgumentTypeError(f"'{text}' is no seed: seeds are 0 to 2^63 - 1")
    return int(text)


class Pace:
    """Keeps virtual time from running ahead of the wall clock.

    Parameters
    ----------
    factor : float
        Virtual seconds a second; 0: no limit.
    """

    def __init__(self, factor: float) -> None:
        self._factor = factor
        self._start = time.monotonic()

    @property
    def elapsed_s(self) -> float:
        """Wall time since the start."""
        return time.monotonic() - self._start

    def wait(self, virtual_s: float) -> None:
        """Sleep until the wall clock has caught up."""
        if self._factor > 0.0:
            ahead = virtual_s / self._factor - self.elapsed_s
            if ahead > 0.0:
                time.sleep(ahead)


def run(arguments: argparse.Namespace) -> int:
    """Run the bench until its time is over or it is interrupted.

    Raises
    ------
    UserError
        Bad scenario, channel or name.
    SystemFailure
        A board stopped, or the channel is gone.
    """
    scenario = load_scenario(arguments.scenario)
    site_file = site_toml(scenario).encode()
    force_site = arguments.force or (arguments.site is not None and holds(arguments.site, site_file))
    check_outputs({"--site": arguments.site}, {"SCENARIO": arguments.scenario}, force=force_site)
    outputs = {"--truth": arguments.truth, "--link": arguments.link}
    check_outputs(outputs, {"SCENARIO": arguments.scenario, "--site": arguments.site}, force=arguments.force)
    with ExitStack() as stack:
        stack.enter_context(_interrupted_by_termination())
        site = arguments.site
        if site is None:
            site = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="goldfield-"))) / "site.toml"
        write_file(site, site_file, "the site file", force=force_site)
        bridge = None
        if arguments.can != NO_CAN:
            bridge = CanBridge(arguments.can)
            stack.callback(bridge.close)
        rig = stack.enter_context(Rig(scenario, arguments.boards, arguments.seed, host_on_can=bridge is not None))
        terminals = {}
        for board in rig.sensing:
            terminals[board] = PseudoTerminal()
            stack.callback(terminals[board].close)
        names = {board: _named(arguments.link, terminals[board], scenario, board, stack) for board in terminals}
        tell_truth: Callable[[str], None] | None = _print_line if arguments.json else None
        if arguments.truth is not None:
            file = stack.enter_context(OutputFile(arguments.truth, "the truth", live=True, force=arguments.force))
            tell_truth = _line_writer(file)
        channel = NO_CAN if bridge is None else bridge.channel
        pace = Pace(arguments.pace)
        try:
            _announce(arguments, scenario, channel, names, site)
            _serve(arguments, rig, terminals, bridge, tell_truth, pace)
        except KeyboardInterrupt:
            pass
        finally:
            _summarise(arguments, rig, sum(terminal.lost for terminal in terminals.values()), bridge, pace)
    return 0


def _named(link: Path | None, terminal: PseudoTerminal, scenario: Scenario, board: int, stack: ExitStack) -> str:
    """Give a board's port its stable name, if one is wanted; return the name by which it is told."""
    if link is None:
        return terminal.path
    path = link if board == SENSOR else link.with_name(f"{link.name}.{scenario.beacons[board - 1].node}")
    stack.callback(PortName(path, terminal.path).close)
    return str(path)


def _serve(
    arguments: argparse.Namespace,
    rig: Rig,
    terminals: Mapping[int, PseudoTerminal],
    bridge: CanBridge | None,
    tell_truth: Callable[[str], None] | None,
    pace: Pace,
) -> None:
    end_s = LONGEST_S if arguments.seconds is None else arguments.seconds
    slices = 0
    next_progress_s = PROGRESS_S
    while slices * SLICE_S < end_s:
        for board, terminal in terminals.items():
            rig.serial_write(terminal.read(), board)
        if bridge is not None:
            bridge.to_boards(rig)
        slices += 1
        rig.run_until(round(min(slices * SLICE_S, end_s) * 1e12))
        for line in rig.truth():  # before the messages: who has read a cycle finds its truth
            if tell_truth is not None:
                tell_truth(json.dumps(line.as_dict()))
        for board, terminal in terminals.items():
            terminal.write(rig.serial_read(board), wait=arguments.pace == 0.0)
        if bridge is not None:
            bridge.to_host(rig)
        pace.wait(rig.now_s)
        if not arguments.json and rig.now_s >= next_progress_s:
            next_progress_s += PROGRESS_S
            print(f"{rig.now_s:8.1f} s, {rig.now_s / pace.elapsed_s:.2f} virtual seconds a second", flush=True)


def _announce(
    arguments: argparse.Namespace, scenario: Scenario, channel: str, serial: Mapping[int, str], site: Path
) -> None:
    anchors = {scenario.beacons[board - 1]: path for board, path in serial.items() if board != SENSOR}
    reads = read_command("--port", str(Path(serial[SENSOR]).absolute()), site=site)
    if arguments.json:
        first: dict[str, Any] = {"serial": serial[SENSOR], "can": channel, "scenario": arguments.scenario}
        first |= {"boards": arguments.boards, "read": reads}
        if anchors:
            first["anchors"] = {anchor.id: {"node": anchor.node, "serial": path} for anchor, path in anchors.items()}
        print(json.dumps(first), flush=True)
        return
    print(f"serial {serial[SENSOR]}, CAN {channel}: {arguments.scenario} with {arguments.boards} boards", flush=True)
    for anchor, path in anchors.items():
        print(f"serial {path}: anchor {anchor.id}, node {anchor.node}", flush=True)
    print(f"poses: {reads}", flush=True)
    if channel != NO_CAN:
        print(f"by CAN: {read_command('--can', channel, site=site)}", flush=True)


def _summarise(arguments: argparse.Namespace, rig: Rig, lost: int, bridge: CanBridge | None, pace: Pace) -> None:
    elapsed_s = pace.elapsed_s
    line = f"{rig.now_s:.3f} virtual seconds in {elapsed_s:.3f} s: {rig.now_s / elapsed_s:.2f} virtual seconds a second"
    if lost:
        line += f"; {lost} serial bytes lost to a slow reader"
    if bridge is not None:
        line += f"; CAN: {bridge.taken} frames from outside, {bridge.refused} refused"
        line += f", {bridge.lost} to outside lost" if bridge.lost else ""
    print(line, file=sys.stderr if arguments.json else sys.stdout, flush=True)


def _print_line(line: str) -> None:
    print(line, flush=True)


def _line_writer(file: OutputFile) -> Callable[[str], None]:
    """Return what appends a line to a file, which ends the run if the file cannot be written."""
    return lambda line: file.write(f"{line}\n".encode())


@contextmanager
def _interrupted_by_termination() -> Iterator[None]:
    """Let SIGTERM, and a terminal that is closed, end the run as Ctrl-C does."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    wanted = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, interrupt) for number in wanted}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``goldfield hil`` with arguments and return its exit code."""
    return goldfield_main(["hil", *(sys.argv[1:] if argv is None else argv)])


if __name__ == "__main__":
    sys.exit(main())

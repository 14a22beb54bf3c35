"""The work of ``goldfield hil``: a rig whose links other processes open, in step with the wall clock."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from goldfield.errors import UserError, counted
from goldfield.files.outputs import OutputFile, check_outputs, holds, write_file
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from hil_sim import LONGEST_S, NO_CAN
from hil_sim.links.can_bridge import CanBridge
from hil_sim.links.port_name import PortName
from hil_sim.links.pseudo_terminal import PseudoTerminal
from hil_sim.links.read_command import read_command
from hil_sim.links.readers import Readers
from hil_sim.rig import SENSOR, Rig, Truth, point_row
from hil_sim.rig.known_points import HEADER
from hil_sim.scenario import Scenario, load_scenario, site_toml, true_site_toml

SLICE_S = 0.005
"""Virtual time between two services of the links."""
PROGRESS_S = 5.0
STARTED_S = 2.0
"""Virtual time in which boards start and find their time; a bench that waits for its readers runs so long by itself."""
OPENING_S = 0.02
"""Wall time between two looks at whether a port was opened, for a bench that waits for its readers."""
FILES = ("site", "true_site", "truth", "points", "link")
"""The options that name a file to write."""


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
        self._paused_s = 0.0

    @property
    def elapsed_s(self) -> float:
        """Wall time since the start, without that in which the bench stood still."""
        return time.monotonic() - self._start - self._paused_s

    def pause_until(self, done: Callable[[], bool]) -> None:
        """Stand still until something holds, and do not catch up afterwards."""
        before = time.monotonic()
        while not done():
            time.sleep(OPENING_S)
        self._paused_s += time.monotonic() - before

    def wait(self, virtual_s: float) -> None:
        """Sleep until the wall clock has caught up."""
        if self._factor > 0.0:
            ahead = virtual_s / self._factor - self.elapsed_s
            if ahead > 0.0:
                time.sleep(ahead)


def serve(arguments: argparse.Namespace) -> int:
    """Run the bench until its time is over or it is interrupted, and return 0.

    Parameters
    ----------
    arguments : argparse.Namespace
        The options of ``goldfield hil``.

    Raises
    ------
    UserError
        Bad scenario, channel or name.
    SystemFailure
        A board stopped, or the channel is gone.
    """
    scenario = load_scenario(arguments.scenario, arguments.seed)
    if arguments.points is not None and not scenario.visits:
        raise UserError(f"--points: the scenario {scenario.name} has no [[known_point]] at which a walk stands still")
    with ExitStack() as stack:
        site = _write_sites(arguments, scenario, stack)
        bridge = None
        if arguments.can != NO_CAN:
            bridge = CanBridge(arguments.can)
            stack.callback(bridge.close)
        rig = Rig(
            scenario,
            arguments.boards,
            arguments.seed,
            host_on_can=bridge is not None,
            cycles_per_instruction=arguments.cycles_per_instruction,
        )
        stack.enter_context(rig)
        terminals = {}
        for board in rig.sensing:
            terminals[board] = PseudoTerminal()
            stack.callback(terminals[board].close)
        names = {board: _named(arguments.link, terminals[board], scenario, board, stack) for board in terminals}
        tell_truth = _truth_tellers(arguments, scenario, stack)
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


def _write_sites(arguments: argparse.Namespace, scenario: Scenario, stack: ExitStack) -> Path:
    """Write the site files, and return where the host's is; one that is there already may be the same."""
    outputs = {f"--{name.replace('_', '-')}": getattr(arguments, name) for name in FILES}
    check_outputs(outputs, {"SCENARIO": arguments.scenario}, force=True)
    texts = {"--site": site_toml(scenario).encode(), "--true-site": true_site_toml(scenario).encode()}
    same = {option for option, text in texts.items() if outputs[option] is not None and holds(outputs[option], text)}
    check_outputs(outputs | dict.fromkeys(same), {}, force=arguments.force)
    if arguments.true_site is not None:
        forced = arguments.force or "--true-site" in same
        write_file(arguments.true_site, texts["--true-site"], "the true site file", force=forced)
    site: Path | None = arguments.site
    if site is None:
        site = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="goldfield-"))) / "site.toml"
    write_file(site, texts["--site"], "the site file", force=arguments.force or "--site" in same)
    return site


def _truth_tellers(
    arguments: argparse.Namespace, scenario: Scenario, stack: ExitStack
) -> list[Callable[[Truth], None]]:
    """Return who is told each cycle's truth: its line, wherever it goes, and the table of known points."""
    tellers: list[Callable[[Truth], None]] = []
    if arguments.truth is not None:
        lines = stack.enter_context(OutputFile(arguments.truth, "the truth", live=True, force=arguments.force))
        tellers.append(lambda truth: lines.write(f"{json.dumps(truth.as_dict())}\n".encode()))
    elif arguments.json:
        tellers.append(lambda truth: print(json.dumps(truth.as_dict()), flush=True))
    if arguments.points is not None:
        table = stack.enter_context(OutputFile(arguments.points, "the points", live=True, force=arguments.force))
        table.write(f"{HEADER}\n".encode())

        def tell_point(truth: Truth) -> None:
            if row := point_row(scenario, truth):
                table.write(f"{row}\n".encode())

        tellers.append(tell_point)
    return tellers


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
    tell_truth: Sequence[Callable[[Truth], None]],
    pace: Pace,
) -> None:
    end_s = LONGEST_S if arguments.seconds is None else arguments.seconds
    readers = Readers(rig, terminals)
    slices = 0
    next_progress_s = PROGRESS_S
    while slices * SLICE_S < end_s:
        if arguments.wait and rig.now_s >= STARTED_S:
            pace.pause_until(readers.ready)
        for board, terminal in terminals.items():
            rig.serial_write(terminal.read(), board)
        if bridge is not None:
            bridge.to_boards(rig)
        slices += 1
        rig.run_until(round(min(slices * SLICE_S, end_s) * 1e12))
        for truth in rig.truth():  # before the messages: who has read a cycle finds its truth
            for tell in tell_truth:
                tell(truth)
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
    port = str(Path(serial[SENSOR]).absolute())
    reads = read_command("--port", port, *_rate(scenario.links.serial_baud, SERIAL_RATES), site=site)
    if arguments.json:
        first: dict[str, Any] = {"serial": serial[SENSOR], "can": channel, "scenario": arguments.scenario}
        first |= {"boards": arguments.boards, "read": reads}
        if anchors:
            first["anchors"] = {anchor.id: {"node": anchor.node, "serial": path} for anchor, path in anchors.items()}
        print(json.dumps(first), flush=True)
        return
    print(f"serial {serial[SENSOR]}, CAN {channel} ({arguments.scenario}, {arguments.boards} boards)", flush=True)
    for anchor, path in anchors.items():
        print(f"serial {path}: anchor {anchor.id}, node {anchor.node}", flush=True)
    print(f"poses: {reads}", flush=True)
    if channel != NO_CAN:
        rate = _rate(scenario.links.can_bit_s, CAN_RATES)
        print(f"by CAN: {read_command('--can', channel, *rate, site=site)}", flush=True)


def _rate(bit_rate: int, rates: Sequence[int]) -> tuple[str, ...]:
    """Return the option that tells a host the rate of a link, which it would else take for the highest one."""
    return () if bit_rate == rates[0] else ("--bit-rate", str(bit_rate))


def _summarise(arguments: argparse.Namespace, rig: Rig, lost: int, bridge: CanBridge | None, pace: Pace) -> None:
    elapsed_s = pace.elapsed_s
    line = f"{rig.now_s:.3f} virtual seconds in {elapsed_s:.3f} s: {rig.now_s / elapsed_s:.2f} virtual seconds a second"
    if lost:
        line += f"; {counted(lost, 'serial bytes lost')} to a slow reader"
    if bridge is not None:
        line += f"; CAN: {counted(bridge.taken, 'frames from outside')}, {bridge.refused} refused"
        line += f", {bridge.lost} to outside lost" if bridge.lost else ""
    print(line, file=sys.stderr if arguments.json else sys.stdout, flush=True)

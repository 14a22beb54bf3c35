"""``goldfield ports``: the serial ports and CAN interfaces of this machine, each with the line that reads it."""

from __future__ import annotations

import argparse
import json
import shlex
from dataclasses import asdict
from typing import Any

from goldfield.cli import options


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "ports",
        help="serial ports and CAN interfaces",
        description="The serial ports and CAN interfaces of this machine: what they seem to be, whether you may open "
        "them, and the line to paste that reads them. Nothing is opened.",
    )
    options.add_site(parser)
    options.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a line for each port and interface."""
    from goldfield.link.ports import can_interfaces, serial_ports  # only when somebody asks

    site = arguments.site or "SITE.toml"
    ports, interfaces = serial_ports(), can_interfaces()
    if arguments.json:
        for port in ports:
            print(json.dumps({"kind": "serial", **asdict(port), "run": _line("--port", port.path, site)}))
        for bus in interfaces:
            where = f"{bus.interface}:{bus.channel}"
            print(json.dumps({"kind": "can", **asdict(bus), "run": _line("--can", where, site)}))
        return 0
    for port in ports:
        said = [port.description, port.manufacturer, port.usb, port.serial_number]
        about = ", ".join(dict.fromkeys(part for part in said if part))
        _print(port.path, f"{port.seems}{f' ({about})' if about else ''}", port.problem, "--port", port.path, site)
    for bus in interfaces:
        where = f"{bus.interface}:{bus.channel}"
        _print(where, "CAN interface", bus.problem, "--can", where, site)
    if not ports and not interfaces:
        print("no serial port and no CAN interface was found: plug the adapter in, and look at the end of dmesg")
    return 0


def _line(option: str, where: str, site: str) -> str:
    return f"goldfield run {option} {shlex.quote(where)} --site {shlex.quote(site)}"


def _print(name: str, what: str, problem: str | None, option: str, where: str, site: str) -> None:
    print(f"{name}: {what}")
    if problem is not None:
        print(f"    {problem}")
    print(f"    {_line(option, where, site)}")

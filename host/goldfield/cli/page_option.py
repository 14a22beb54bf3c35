"""The option ``--view [ADDRESS:PORT]`` of a command that reads a sensor: the live page beside what it prints."""

from __future__ import annotations

import argparse

from goldfield.cli import options


def add_view(parser: argparse.ArgumentParser) -> None:
    """Add the option."""
    options.add(
        parser,
        "--view",
        metavar="ADDRESS:PORT",
        what="serve the live page meanwhile, at this address as goldfield view does with --bind, or without one at "
        "port 8420 of this machine alone; stderr tells where it is",
        alone="",
    )

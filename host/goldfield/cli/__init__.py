"""The command ``goldfield``: one file a subcommand."""

from goldfield.cli.entry import main

__all__ = ["main"]

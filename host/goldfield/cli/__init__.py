"""The command ``goldfield``: one file a subcommand."""

from goldfield.cli.main import main

__all__ = ["main"]

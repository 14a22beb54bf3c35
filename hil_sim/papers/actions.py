"""Actions of ``goldfield paper``, loaded when they are called: the parsers alone need no array library."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pkgutil import resolve_name

from goldfield.errors import SystemFailure
from goldfield.files.outputs import check_outputs


def action(name: str) -> Callable[[argparse.Namespace], int]:
    """Return the function that runs an action.

    Parameters
    ----------
    name : str
        ``module:function`` below `hil_sim.papers`. The function takes the parsed arguments and returns the exit code.
    """

    def run(arguments: argparse.Namespace) -> int:
        try:
            function = resolve_name(f"hil_sim.papers.{name}")
        except ImportError as error:
            raise SystemFailure(
                f'the experiment cannot be loaded ({error}): install its packages with pip install "goldfield[sim]"'
            ) from error
        figure, force = getattr(arguments, "figure", None), getattr(arguments, "force", False)
        check_outputs({"--figure": figure}, {"--site": getattr(arguments, "site", None)}, force=force)
        return int(function(arguments))

    return run

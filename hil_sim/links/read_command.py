"""The command that reads a bench, to be pasted into another terminal."""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path


def read_command(*source: str, site: Path) -> str:
    """Return the command line that prints the poses of a bench.

    It works in any directory: the program is named by its path unless the shell finds this very one by its name.

    Parameters
    ----------
    *source : str
        The option that names the bench, and its value, and others of the link.
    site : path
        Its site file.
    """
    return shlex.join([*_program(), "run", *source, "--site", str(site.absolute())])


def _program() -> list[str]:
    mine = Path(sys.executable).with_name("goldfield")
    if not mine.exists():
        return [sys.executable, "-m", "goldfield"]
    found = shutil.which("goldfield")
    return ["goldfield"] if found is not None and mine.samefile(found) else [str(mine)]

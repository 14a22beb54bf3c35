"""A pose for every epoch, whatever happens."""

from __future__ import annotations

import traceback
from collections.abc import Callable

from goldfield.errors import UserError, tell
from goldfield.files.environment import switched_on
from goldfield.types import Fields, Pose


def guarded(method: Callable[[Fields], Pose], fields: Fields) -> Pose:
    """Locate by a method; a defect in it costs this epoch and is told on stderr, not the run.

    Raises
    ------
    UserError
        If the method finds that the site cannot be located on.
    """
    try:
        return method(fields)
    except UserError:
        raise
    except Exception as error:
        show_defect()
        tell(f"epoch {fields.epoch}: location failed unexpectedly ({type(error).__name__}: {error}): please report it")
        return Pose.failed(fields, excluded=fields.beacons)


def show_defect() -> None:
    """Print the traceback of the exception that is being handled, if the user wants to see it."""
    if switched_on("GOLDFIELD_DEBUG"):
        traceback.print_exc()

"""The formats of recordings, chosen by the ending of a file's name."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import can

from goldfield.errors import UserError
from goldfield.files.inputs import STREAM
from goldfield.link.log_writers import AscWriter, BlfWriter
from goldfield.link.recordings import CandumpWriter
from goldfield.recording.about import About
from goldfield.sensor.pipeline import Epoch, Fix

READ_ONLY = (".csv", ".db", ".gz", ".mf4", ".trc")
"""Endings of formats that are read as logs, and not written."""


class Writer(Protocol):
    """Writes messages."""

    @property
    def failed(self) -> bool:
        """Whether the recording is not whole."""
        ...

    def write(self, item: can.Message, /) -> None:
        """Append a message."""
        ...

    def close(self) -> None:
        """End the recording."""
        ...


class Recording(Protocol):
    """Writes messages as they come, and what they make if the format has room for it."""

    @property
    def failed(self) -> bool:
        """Whether the recording is not whole."""
        ...

    def write(self, item: can.Message | Epoch | Fix, /) -> None:
        """Append an item; `BrokenPipeError` if nobody reads stdout any more."""
        ...

    def close(self) -> None:
        """End the recording."""
        ...


class MessagesOnly:
    """A recording in a format for messages: what they make is left out.

    Parameters
    ----------
    writer : Writer
    """

    def __init__(self, writer: Writer) -> None:
        self._writer = writer

    @property
    def failed(self) -> bool:
        """Whether the recording is not whole."""
        return self._writer.failed

    def write(self, item: can.Message | Epoch | Fix, /) -> None:
        """Append a message."""
        if isinstance(item, can.Message):
            self._writer.write(item)

    def close(self) -> None:
        """End the recording."""
        self._writer.close()


def open_recording(path: str | Path, about: About, *, force: bool = False) -> Recording:
    """Begin a recording in the format that the ending of its name tells.

    ``.mcap`` is a recording of everything for Foxglove, ``.asc`` and ``.blf`` are logs for Vector's tools, and any
    other name, and ``-``, is a log of candump.

    Parameters
    ----------
    path : path
        ``-`` is stdout.
    about : About
    force : bool
        Whether a file that holds something may be replaced, which the first message does.

    Raises
    ------
    UserError
        If the format is one that is only read, its package is not installed, the file cannot be made, or it holds
        something already.
    """
    ending = "" if str(path) == STREAM else Path(path).suffix.lower()
    if ending in READ_ONLY:
        raise UserError(f"{path}: {ending} is read and not written: give a name that ends in .mcap, .log, .asc or .blf")
    if ending == ".mcap":
        return _mcap(path, about, force=force)
    if ending == ".asc":
        return MessagesOnly(AscWriter(path, force=force))
    return MessagesOnly(BlfWriter(path, force=force) if ending == ".blf" else CandumpWriter(path, force=force))


def _mcap(path: str | Path, about: About, *, force: bool) -> Recording:
    try:
        from goldfield.recording.mcap_recording import McapRecording  # heavy, and of an extra
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "foxglove":
            raise
        raise UserError(
            f"{path}: a recording in MCAP needs the package foxglove-sdk: install it with pip install "
            "'goldfield[mcap]', or give a name that ends in .log"
        ) from error
    return McapRecording(path, about, force=force)

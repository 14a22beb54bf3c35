"""The file of a recording: what fails of it ends the recording, is told in a sentence, and lets the run go on."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from goldfield.errors import SystemFailure, counted, tell
from goldfield.files.inputs import STREAM, reason_of
from goldfield.files.outputs import OutputFile

FLUSH_S = 0.25
"""Time from one piece to the next, s, in formats that pack messages into pieces: as much costs a killed program."""


class RecordingFile:
    """A growing file that is handed to the system at once, and to the disk within a second (`goldfield.files.durable`).

    A failing disk (full, removed) ends the recording with a message on stderr, and cuts a torn last record off.

    Parameters
    ----------
    path : path
        ``-`` is stdout.
    force : bool
        Whether a file that holds something may be replaced, which its first record does.

    Attributes
    ----------
    name : str
        The path, for messages.
    failed : bool
        Whether the recording is not whole.

    Raises
    ------
    UserError
        If the file cannot be made, or holds something already.
    """

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        self.name = "stdout" if str(path) == STREAM else str(path)
        self.failed = False
        self._file = OutputFile(path, "the recording", live=True, force=force)

    @property
    def size(self) -> int:
        """Bytes that were written."""
        return self._file.size

    @property
    def rewritable(self) -> bool:
        """Whether what was written can be written over."""
        return self._file.rewritable

    def write(self, data: bytes, at: int | None = None) -> bool:
        """Append a record, or write it over what stands at an offset.

        Returns
        -------
        bool
            Whether it is written: False from the first failure on, which is told.

        Raises
        ------
        BrokenPipeError
            If nobody reads stdout any more.
        """
        if self.failed:
            return False
        try:
            self._file.write(data, at)
        except SystemFailure as error:
            self.failed = True
            why = error.__cause__
            reason = str(error) if why is None else reason_of(why)
            tell(
                f"{self.name}: recording stopped after {counted(self.size, 'bytes')}: {reason}; the run goes on",
                failure=True,
            )
            return False
        return True

    def mend(self, data: bytes, at: int) -> None:
        """Write over what stands at an offset after a failure, without a word if that fails, too."""
        with suppress(SystemFailure, BrokenPipeError):
            self._file.write(data, at)

    def close(self) -> None:
        """End the recording, of which the disk may fail to take the last part."""
        try:
            self._file.close()
        except SystemFailure as error:
            self.failed = True
            tell(str(error), failure=True)

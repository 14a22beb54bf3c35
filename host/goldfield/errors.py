"""The one exception whose text a user reads."""

from __future__ import annotations


class UserError(Exception):
    """Bad usage or bad input: one sentence that says what was wrong, where, and what to do.

    The CLI prints it as one line and exits with 2.
    """

"""The exceptions whose text a user reads: one sentence that says what was wrong, where, and what to do."""

from __future__ import annotations


class UserError(Exception):
    """Bad usage or bad input; the CLI prints it as one line and exits with 2."""


class SystemFailure(Exception):
    """The boards or the link to them failed; the CLI prints it as one line and exits with 3."""

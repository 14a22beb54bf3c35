"""``goldfield keys``: the key pair by which the boards of a site know who may make images for them.

What takes long to import is imported by `run`.
"""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any

from goldfield.cli import options
from goldfield.errors import UserError

PASSPHRASE = options.environment_name("passphrase")


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "keys",
        help="the key pair that signs a site's images",
        description="Makes the key pair of a site, or shows the public key of one. The private key signs images "
        "(goldfield image sign) and stays in its file; the public key goes into each board, once, with a probe.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", dest="action", required=True)
    make = actions.add_parser(
        "make",
        help="make a key pair",
        description="Makes a key pair, keeps the private key in a new file that only its owner may read, and prints "
        "the public key.",
    )
    make.add_argument(
        "--passphrase",
        action="store_true",
        help=f"ask for a passphrase, without which the key is of no use (environment: {PASSPHRASE} holds one)",
    )
    show = actions.add_parser("show", help="print the public key", description="Prints the public key of a key pair.")
    for action in (make, show):
        action.add_argument("file", metavar="FILE", help="file of the private key")
        options.add_json(action)
    parser.set_defaults(run=run)


def passphrase(path: str, *, twice: bool = False) -> bytes:
    """Return the passphrase of a key: that of the environment, or what the user types.

    Raises
    ------
    UserError
        There is neither, or it was typed in two ways.
    """
    given = os.environ.get(PASSPHRASE, "")
    if not given and (sys.stdin is None or not sys.stdin.isatty()):
        raise UserError(f"{path}: needs a passphrase, and there is no terminal to ask for it: set {PASSPHRASE}")
    if not given:
        from getpass import getpass

        given = getpass(f"passphrase of {path}: ")
        if twice and given != getpass("once more: "):
            raise UserError(f"{path}: the passphrase was typed in two ways: try again")
    if not given:
        raise UserError(f"{path}: the passphrase is empty: give one, or make the key without --passphrase")
    return given.encode()


def run(arguments: argparse.Namespace) -> int:
    """Do what is asked."""
    from goldfield.cli.output import json_line
    from goldfield.update import keys

    path = arguments.file
    if arguments.action == "make":
        public = keys.make(path, passphrase(path, twice=True) if arguments.passphrase else None)
    else:
        public = keys.public_bytes(keys.load(path, lambda: passphrase(path)))
    if arguments.json:
        print(json_line({"file": path, "public_key": public.hex()}))
    else:
        print(public.hex())
    return 0

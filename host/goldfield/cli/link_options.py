"""The options that name a link, ``--port``, ``--can``, ``--log``, and those that say how a sensor on it is read."""

from __future__ import annotations

import argparse
import os

from goldfield.cli import options
from goldfield.errors import UserError
from goldfield.link.access_key import AccessKey, load_key
from goldfield.sensor.options import Method, Options

LINKS = {
    "port": ("PATH", "serial port of the sensor"),
    "can": ("INTERFACE:CHANNEL", "python-can interface and channel, as socketcan:can0"),
    "log": (
        "FILE",
        "recording instead of a sensor: of candump, or .asc, .blf, .csv, .db, .mcap, .mf4, .trc; - is stdin",
    ),
}


def add(parser: argparse.ArgumentParser, *, log: bool = False, nested: bool = False) -> None:
    """Add the options; ``nested``: to the parser of an action, where they do not undo what stands before it."""
    add_key(parser, nested=nested)
    add_bit_rate(parser, nested=nested)
    for name, (metavar, what) in LINKS.items():
        if name != "log" or log:
            variable = options.environment_name(name)
            parser.add_argument(
                f"--{name}",
                metavar=metavar,
                default=argparse.SUPPRESS if nested else None,
                help=f"{what} (environment: {variable}, unless another is given)",
            )


def add_bit_rate(parser: argparse.ArgumentParser, *, nested: bool = False) -> None:
    """Add ``--bit-rate``; ``nested`` as for `add`."""
    variable = options.environment_name("--bit-rate")
    parser.add_argument(
        "--bit-rate",
        metavar="N",
        type=options.bit_rate,
        default=argparse.SUPPRESS if nested else os.environ.get(variable) or None,
        help="bits a second of the link (default: a serial port's is found, CAN's is the interface's own, else "
        f"1000000; environment: {variable})",
    )


def add_key(parser: argparse.ArgumentParser, *, nested: bool = False) -> None:
    """Add ``--key``, of a command that sets boards; ``nested`` as for `add`."""
    variable = options.environment_name("--key")
    parser.add_argument(
        "--key",
        metavar="FILE",
        default=argparse.SUPPRESS if nested else os.environ.get(variable) or None,
        help=f"the site's key, for boards that are locked (environment: {variable})",
    )


def key(arguments: argparse.Namespace) -> AccessKey | None:
    """Return the key that is given, None if none is; `UserError` if its file cannot be used."""
    return None if not arguments.key else load_key(arguments.key)


def chosen(arguments: argparse.Namespace) -> tuple[str, str]:
    """Return kind and place of the link: the command line's, else the environment's.

    Raises
    ------
    UserError
        If none or more than one is given.
    """
    names = [name for name in LINKS if hasattr(arguments, name)]
    given = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    if not given:
        given = {
            name: os.environ[variable] for name in names if os.environ.get(variable := options.environment_name(name))
        }
    if len(given) != 1:
        wanted = [f"--{name} {LINKS[name][0]}" for name in names]
        raise UserError(
            f"{'no source is' if not given else 'more than one source is'} given: give one of "
            f"{', '.join(wanted[:-1])} and {wanted[-1]}"
        )
    ((kind, where),) = given.items()
    if not where:
        raise UserError(f"--{kind} is empty: give a value")
    if kind == "log":
        options.tell_idle(arguments, ("--bit-rate",), "--log")
    return kind, where


def add_strongest(parser: argparse.ArgumentParser) -> None:
    """Add ``--strongest``."""
    options.add(
        parser,
        "--strongest",
        metavar="K",
        what="let the sensor report the K strongest codes that it hears in each cycle, and not those of the site",
        kind=options.count,
    )


def add_reading(parser: argparse.ArgumentParser, *, channel: bool = True, reconnect: bool = True) -> None:
    """Add the options that say how a sensor is read.

    ``channel``: the source may have several channels; ``reconnect``: the user says whether a link that is gone is
    waited for, which else is so.
    """
    options.add(parser, "--node", metavar="N", what="node of the sensor, where there are several", kind=options.node)
    if channel:
        options.add(parser, "--channel", metavar="NAME", what="channel of the sensor, in a log of several buses")
    options.add_switch(parser, "--listen-only", what="send nothing, ever: for a bus on which a recording is replayed")
    if reconnect:
        options.add_switch(
            parser, "--reconnect", what="wait for a port that is gone or a sensor that is silent, and go on"
        )


def reading(arguments: argparse.Namespace, method: Method = Method.EACH) -> Options:
    """Return what the options of `add_reading` say, and ``--seconds``, ``--rate``, ``--lag`` if a command has them."""
    return Options(
        method,
        arguments.node,
        getattr(arguments, "seconds", None),
        channel=getattr(arguments, "channel", None),
        listen_only=arguments.listen_only,
        reconnect=getattr(arguments, "reconnect", True),
        rate_hz=getattr(arguments, "rate", None),
        lag_s=getattr(arguments, "lag", None),
        awaits=getattr(arguments, "reconnect", False),
        strongest=getattr(arguments, "strongest", None),
        key=key(arguments),
        bit_rate=arguments.bit_rate,
    )

"""Parts of pages that are made from the code: the command line, the messages of the DBC, the public names of Python."""

from __future__ import annotations

import argparse
import os
import textwrap
from collections.abc import Callable, Iterator
from enum import EnumType
from pathlib import Path

import cantools

USAGE_WIDTH = 100
"""Columns of a usage line, so that it does not depend on the terminal of the build."""
NOT_SHOWN = (argparse._SubParsersAction, argparse._HelpAction)
MESSAGES = Path(__file__).resolve().parents[2] / "protocol/goldfield_protocol/goldfield.dbc"


def commands() -> str:
    """Return all subcommands with their options, from the parsers themselves."""
    from goldfield.cli.entry import build_parser

    for name in [name for name in os.environ if name.startswith("GOLDFIELD_")]:
        del os.environ[name]  # else they were the defaults
    os.environ["COLUMNS"] = str(USAGE_WIDTH)
    return "\n".join(line for name, parser in _subparsers(build_parser(every=True)) for line in _command(name, parser))


def _subparsers(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the subcommands of a parser, each with its own behind it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for one in action.choices.values():
                yield one.prog, one
                yield from _subparsers(one)


def _command(name: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    level = "#" * min(len(name.split()), 4)
    yield from (f"{level} {name}", "", _escaped(parser.description or ""), "")
    yield from ("```text", parser.format_usage().removeprefix("usage: ").rstrip(), "```", "")
    for group in parser._action_groups:
        shown = [
            action
            for action in group._group_actions
            if action.help != argparse.SUPPRESS and not isinstance(action, NOT_SHOWN)
        ]
        for action in shown:
            yield from (_invocation(action), f": {_meaning(action, parser)}", "")


def _invocation(action: argparse.Action) -> str:
    """Return how an argument is written: `--port PATH`."""
    value = argparse.HelpFormatter("")._format_args(action, str(action.metavar or action.dest.upper()))
    if isinstance(action.metavar, tuple):
        value = " ".join(action.metavar)
    if action.choices is not None and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    if not action.option_strings:
        return f"`{value}`"
    return ", ".join(f"`{name}{' ' if value else ''}{value}`" for name in action.option_strings)


def _meaning(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    formatter = parser._get_formatter()
    return _escaped(formatter._expand_help(action) if action.help else "") or "—"


def _escaped(text: str) -> str:
    """Return text in which Markdown sees no marks; words in capitals and options stay as they are."""
    plain = " ".join(text.split())
    for mark in "\\`*_[]<>#|":
        plain = plain.replace(mark, f"\\{mark}")
    return plain.replace("--", "\\-\\-")


def messages() -> str:
    """Return each message of the DBC with its signals."""
    database = cantools.database.load_file(MESSAGES, strict=False)
    return "\n".join(
        line for message in sorted(database.messages, key=lambda one: one.frame_id) for line in _message(message)
    )


def _message(message: cantools.database.Message) -> Iterator[str]:
    largest = message.dbc.attributes.get("LargestIndex") if message.dbc else None
    index = f", index 0 to {largest.value}" if largest is not None and largest.value else ", index 0"
    yield from (f"## {message.name}", "")
    yield from (f"Type {message.frame_id >> 24} (`0x{message.frame_id:08X}`), {message.length} bytes{index}.", "")
    yield from (_escaped(message.comment or ""), "")
    yield from ("| signal | bits | unit | step | range | meaning |", "| --- | --- | --- | --- | --- | --- |")
    for signal in sorted(message.signals, key=lambda one: one.start):
        choices = ", ".join(f"{number} {word}" for number, word in (signal.choices or {}).items())
        meaning = "; ".join(part for part in (signal.comment or "", choices) if part)
        bits = f"{signal.start}..{signal.start + signal.length - 1}" if signal.length > 1 else str(signal.start)
        cells = [f"`{signal.name}`", bits, signal.unit or "", _step(signal), _range(signal), _escaped(meaning)]
        yield f"| {' | '.join(cells)} |"
    yield ""


def _step(signal: cantools.database.Signal) -> str:
    return "float" if signal.is_float else f"{signal.scale:g}"


def _range(signal: cantools.database.Signal) -> str:
    """Return the range of values that the signal's bits can say."""
    if signal.is_float:
        return ""
    least, most = (
        (-(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1)
        if signal.is_signed
        else (0, (1 << signal.length) - 1)
    )
    low, high = (raw * signal.scale + signal.offset for raw in (least, most))
    return f"{low:.10g} to {high:.10g}"


def api(*names: str) -> str:
    """Return the documentation of public names of ``import goldfield`` from their docstrings."""
    import goldfield

    blocks = []
    for name in names:
        thing = getattr(goldfield, name)
        kind = "class" if isinstance(thing, type) else "function"
        home = f"goldfield.{name}.{name}" if name == "locate" else f"goldfield.{name}"
        members = "\n   :members:" if kind == "class" and not issubclass(thing, Exception) else ""
        if isinstance(thing, EnumType):
            members += "\n   :undoc-members:"
        blocks.append(f"```{{eval-rst}}\n.. auto{kind}:: {home}{members}\n```")
    return "\n\n".join(blocks)


def program(path: str) -> str:
    """Return a file of docs/examples as a block of code."""
    text = (Path(__file__).resolve().parents[1] / "examples" / path).read_text(encoding="utf-8")
    return f"### {path}\n\n```python\n{textwrap.dedent(text).rstrip()}\n```"


GENERATORS: dict[str, Callable[..., str]] = {
    "api": api,
    "commands": commands,
    "messages": messages,
    "program": program,
}

"""Every command of goldfield that a page shows is one that the command line's own parser takes."""

from __future__ import annotations

import argparse
import re
import shlex
import textwrap
from pathlib import Path

import pytest

from goldfield.cli.entry import Parser, build_parser
from hil_sim.clib import ROOT
from tests.docs.test_links import DOCUMENTS, make_targets

COMMAND = re.compile(r"^(?: {4,}|\t)?(?:\$ )?(?:sudo )?(?:\S*/)?goldfield (?=[a-z])(.*)$", re.M)
FENCED = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.M | re.S)
INDENTED = re.compile(r"^(?: {4,}|\t)(?:\S*/)?(?:goldfield|make) .*$", re.M)
QUOTED = re.compile(r"`goldfield ([^`]+)`")
MAKE = re.compile(r"^ *(?:[A-Z_]+=\S+ )*make ([a-z][\w-]*)", re.M)
SHELLS = ("sh", "bash", "console")
PORT = "/dev/ttyUSB0"


@pytest.fixture(scope="module")
def parser() -> argparse.ArgumentParser:
    return build_parser(every=True)


def command_lines(text: str) -> list[str]:
    """Return what stands behind ``goldfield`` in each line of a page's blocks of commands, indented ones included."""
    fenced = [block for language, block in FENCED.findall(text) if language in SHELLS]
    indented = INDENTED.findall(FENCED.sub("", text))
    return [line for block in [*fenced, *indented] for line in COMMAND.findall(block)]


def complaint(parser: argparse.ArgumentParser, line: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Return what the parser says against a line of a page, or nothing; what is piped or written away is cut off."""
    words = shlex.split(re.split(r" (?:>>?|\||2>) ", re.split(r" +# ", line)[0])[0])
    words = [PORT if word in ("PORT", "...") else word for word in words if word != "..."]
    capsys.readouterr()
    try:
        parser.parse_args(words)
    except SystemExit as end:
        return "" if end.code == 0 else capsys.readouterr().err
    return ""


def options(parser: argparse.ArgumentParser, words: list[str]) -> set[str]:
    """Return the options of the subcommand that words name, with those of the commands above and below it."""
    found = set(parser._option_string_actions)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            named = [action.choices[word] for word in words if word in action.choices]
            for one in named or action.choices.values():
                found |= options(one, words)
    return found


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_parser_takes_every_command(path: Path, parser, capsys) -> None:
    lines = command_lines(path.read_text(encoding="utf-8"))
    assert {line: said for line in lines if (said := complaint(parser, line, capsys))} == {}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_command_that_the_prose_names_has_its_options(path: Path, parser) -> None:
    wrong = []
    for quoted in QUOTED.findall(path.read_text(encoding="utf-8")):
        words = re.findall(r"[\w-]+", quoted)
        known = options(parser, words)
        wrong += [f"goldfield {quoted}: {word}" for word in words if word.startswith("--") and word not in known]
    assert wrong == []


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_targets_of_make_are_there(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    blocks = [block for language, block in FENCED.findall(text) if language in SHELLS]
    named = {target for block in [*blocks, *INDENTED.findall(FENCED.sub("", text))] for target in MAKE.findall(block)}
    assert named - make_targets() == set()


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_blocks_of_python_are_python(path: Path) -> None:
    for language, block in FENCED.findall(path.read_text(encoding="utf-8")):
        if language == "python":
            compile(textwrap.dedent(block), path.name, "exec")


def test_the_checker_judges_both_ways(parser, capsys) -> None:
    page = (
        "text\n\n    goldfield run --port P --site S  # live\n\n```sh\n.venv/bin/goldfield locate --site S F > x\n```\n"
    )
    good, piped = sorted(command_lines(page), reverse=True)
    assert complaint(parser, good, capsys) == ""
    assert complaint(parser, piped, capsys) == ""
    assert "unrecognized" in complaint(parser, f"{good.partition('  #')[0]} --no-such", capsys)
    assert "invalid choice" in complaint(parser, "hill prigge8", capsys)
    assert command_lines("```text\ngoldfield no command\n```\n") == []
    assert isinstance(parser, Parser)
    assert "--lag" in options(parser, ["run"])
    assert "--pace" not in options(parser, ["run"])

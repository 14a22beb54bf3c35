"""The long commands refuse what cannot be, go on where they were ended, and say in a sentence what goes wrong."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import pytest

from goldfield.errors import SystemFailure, UserError
from hil_sim.clib import ROOT
from tests.bench import day_run, long_run
from tests.bench.peers import __main__ as peers
from tests.campaign import __main__ as campaign
from tests.command import ended, growing, one_of, read_results, real_number, results_in, whole_number
from tests.coverage import report
from tests.fuzz import keep
from tests.image_faults import __main__ as image_faults
from tests.mutants import run as mutants
from tests.proofs import run as proofs

BENCH = ROOT / "tests/bench"


@dataclass
class Result:
    """As a command keeps one."""

    name: str
    seconds: float | None = None
    counts: dict[str, int] = field(default_factory=dict)


ODD: list[tuple[Callable[[list[str]], int], str]] = [
    *[(campaign.main, words) for words in ("--seed -1", "--seeds 0", "--processes 0", "--kind nowhere")],
    *[(image_faults.main, words) for words in ("--every 0", "--workload nowhere", "--kind bit")],
    *[(long_run.main, f"--hours {word}") for word in ("0", "-1", "nan", "inf", "one")],
    *[(long_run.main, f"--cycles-per-instruction {word}") for word in ("0.9", "101", "nan", "m3")],
    *[(day_run.main, words) for words in ("--hours 0", "--hours nan", "--seed -1", "--gap 5 3", "--gap -5 -3")],
    *[(peers.main, words) for words in ("nothing", "decode --rounds 0", "--compare --keep", "decode --keep")],
    *[(mutants.main, f"core {words}") for words in ("--files nowhere.c", "--sample -1", "--budget nan", "--workers 0")],
    (mutants.main, "core --number -1"),
    (mutants.main, "nothing"),
    (proofs.main, "nothing"),
    (keep.main, ""),
]


@pytest.mark.parametrize(("main", "words"), ODD)
def test_what_cannot_be_is_refused_before_anything_is_done(main, words, capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(words.split())
    assert end.value.code == 2
    assert "error: " in capsys.readouterr().err.splitlines()[-1]


def of_its_parser(main: Callable[[], object], monkeypatch) -> argparse.ArgumentParser:
    """Return the parser of a command, which comes as far as to read its words, and no further."""
    found: list[argparse.ArgumentParser] = []

    def parsed(parser: argparse.ArgumentParser, *_: object) -> None:
        found.append(parser)
        raise UserError("read")

    with monkeypatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", parsed)
        with pytest.raises(UserError, match="read"):
            main()
    return found[0]


FIGURES = [path.stem for path in BENCH.glob("*.py") if "ArgumentParser" in path.read_text(encoding="utf-8")]
TEXTS = {"readme_figures": {"only"}, "locate_before": {"revision"}, "rate_figures": {"fault"}}
"""Words of commands of figures that may be any text."""


@pytest.mark.parametrize("name", sorted(FIGURES))
def test_commands_of_figures_refuse_what_cannot_be(name, monkeypatch, capsys) -> None:
    """Whatever word takes a value refuses what is none, and numbers below their least, before anything is measured."""
    main = import_module(f"tests.bench.{name}").main
    for action in of_its_parser(main, monkeypatch)._actions:
        if action.nargs == 0 or action.type is Path or action.dest in TEXTS.get(name, ()):
            continue
        for bad in ("-1", "nan", "nowhere"):
            word = f"{action.option_strings[0]}={bad}" if action.option_strings else bad
            monkeypatch.setattr(sys, "argv", [name, word])
            with pytest.raises(SystemExit) as end:
                main()
            assert end.value.code == 2
            assert "error: " in capsys.readouterr().err


@pytest.mark.parametrize("target", ["core/nowhere", "nowhere", "../../x/frames", "core", "host/judging"])
def test_a_corpus_of_no_harness_is_refused_and_nothing_is_made(target, monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(keep, "CORPUS", tmp_path)
    with pytest.raises(UserError, match="is none of core/board"):
        keep.main([target])
    assert not list(tmp_path.iterdir())


def test_a_table_of_coverage_that_was_not_measured_is_told(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(report, "COVERED", tmp_path)
    with pytest.raises(UserError, match="make coverage"):
        report.main()


def test_numbers_are_taken_up_to_their_limits_and_names_that_there_are() -> None:
    assert one_of({"a": 1, "b": 2})("b") == "b"
    with pytest.raises(argparse.ArgumentTypeError, match="'c' is none of a, b"):
        one_of({"a": 1, "b": 2})("c")
    assert [whole_number(1)(word) for word in ("1", "20")] == [1, 20]
    assert [real_number(least=0.5, most=2.0)(word) for word in ("0.5", "2")] == [0.5, 2.0]
    for word in ("0", "-1", "1.0", "--1", "", "x"):
        with pytest.raises(argparse.ArgumentTypeError):
            whole_number(1)(word)
    for word in ("0.49", "2.01", "nan", "inf", ""):
        with pytest.raises(argparse.ArgumentTypeError):
            real_number(least=0.5, most=2.0)(word)


# ---- Files of results ----


def test_lines_that_hold_something_else_are_left_out() -> None:
    good = [Result("a"), Result("b", 1.5, {"x": 2}), Result("c", 2)]
    lines = [json.dumps(vars(one)) for one in good]
    bad = ["", "[1]", "3", "null", '{"name": 1}', '{"seconds": 1}', '{"name": "a", "seconds": "1"}', "[" * 100_000]
    bad += ['{"name": "a", "more": 1}', '{"name": "a", "counts": []}', '{"name": "a", "seconds": true}', lines[0][:9]]
    assert results_in("\n".join([*bad, lines[0], *bad, *lines[1:], "\ufffd\x00"]), Result) == good


def test_a_file_grows_behind_a_line_that_was_cut_off(tmp_path) -> None:
    path = tmp_path / "new" / "results.jsonl"
    with growing(path, Result) as (kept, append):
        assert kept == []
        append(Result("a"))
    path.write_bytes(path.read_bytes() + b'\xff{"name": "b')
    with growing(path, Result) as (kept, append):
        assert kept == [Result("a")]
        append(Result("c"))
        append(Result("d"))
    assert read_results(path, Result) == [Result("a"), Result("c"), Result("d")]


@pytest.mark.parametrize("place", ["", "/dev/full", "/dev/null"])
def test_what_is_no_file_is_not_read(place, tmp_path) -> None:
    path = Path(place) if place else tmp_path
    with pytest.raises(UserError, match="is no file"):
        read_results(path, Result)
    with pytest.raises(UserError, match="is no file"), growing(path, Result):
        pass


def in_a_child(work: Callable[[], None]) -> int:
    """Return the exit code of a forked process: 0, unless the work has raised something."""
    child = multiprocessing.get_context("fork").Process(target=work)
    child.start()
    child.join()
    return child.exitcode or 0


def test_a_second_run_does_not_write_into_the_file_of_a_first(tmp_path) -> None:
    path = tmp_path / "results.jsonl"

    def second() -> None:
        with pytest.raises(UserError, match="another run"), growing(path, Result):
            pass

    def third() -> None:
        with growing(path, Result) as (_, append):
            append(Result("third"))
            os._exit(0)  # As if it were killed: the lock is gone with it.

    with growing(path, Result) as (_, append):
        assert in_a_child(second) == 0
        append(Result("first"))
    assert in_a_child(third) == 0
    with growing(path, Result) as (kept, _):
        assert kept == [Result("first"), Result("third")]


def test_a_result_for_which_there_is_no_room_ends_the_run_and_spoils_nothing(tmp_path) -> None:
    path = tmp_path / "results.jsonl"

    def fill() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
        with growing(path, Result) as (_, append), pytest.raises(SystemFailure, match="cannot be written"):
            list(map(append, map(Result, "abcdefgh")))

    assert in_a_child(fill) == 0
    kept = read_results(path, Result)
    assert kept == [Result(name) for name in "abcdefgh"[: len(kept)]]
    assert len(kept) >= 2
    with growing(path, Result) as (_, append):
        append(Result("z"))
    assert read_results(path, Result) == [*kept, Result("z")]


# ---- The end ----


def raising(error: Exception) -> Callable[[], int]:
    """Return a command that ends so."""

    def main() -> int:
        raise error

    return main


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (UserError("this is not so"), 2, "goldfield: this is not so\n"),
        (SystemFailure("that broke"), 3, "goldfield: that broke\n"),
        (
            PermissionError(13, "Permission denied", "/x"),
            3,
            "goldfield: /x: cannot be read or written: Permission denied\n",
        ),
    ],
)
def test_what_goes_wrong_is_a_sentence(error, code, told, capsys) -> None:
    usual = signal.getsignal(signal.SIGINT)
    try:
        assert ended(raising(error)) == code
    finally:
        signal.signal(signal.SIGINT, usual)
    assert capsys.readouterr().err.endswith(told)
    assert ended(lambda: 7) == 7
    signal.signal(signal.SIGINT, usual)


def program(text: str) -> subprocess.CompletedProcess[str]:
    """Run a program of Python; its output is all that its children said, too, once the last of them has ended."""
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)


def test_an_interrupt_ends_it_where_it_is_without_a_traceback() -> None:
    """In a call of C's as well, which would print an exception and go on."""
    found = program(
        "import ctypes, os, signal\n"
        "from tests.command import ended\n"
        "call = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))\n"
        "ended(lambda: [call() for _ in range(1000)] and print('went on') or 0)\n"
    )
    assert found.returncode == 130
    assert found.stdout == ""
    assert found.stderr.split("\n") == ["", "goldfield: stopped; what was kept of the run stays", ""]


@pytest.mark.parametrize("blow", ["SIGINT", "SIGKILL"])
def test_workers_end_with_the_command(blow) -> None:
    """A worker that stayed would hold the output open, and this test would wait for it for ever."""
    found = program(
        "import os, signal, time\n"
        "from concurrent.futures import ProcessPoolExecutor\n"
        "from tests.command import end_with_parent, ended\n"
        "def main():\n"
        "    pool = ProcessPoolExecutor(2, initializer=end_with_parent)\n"
        "    assert pool.submit(abs, -3).result() == 3\n"
        "    [pool.submit(signal.pause) for _ in range(9)]\n"
        f"    os.kill(os.getpid(), signal.{blow})\n"
        "ended(main)\n"
    )
    assert found.returncode == (130 if blow == "SIGINT" else -9)
    assert "Traceback" not in found.stderr

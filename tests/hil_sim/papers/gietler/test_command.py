"""``goldfield paper gietler``: lines, figures, exit codes, sentences."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from goldfield.errors import UserError
from hil_sim.papers.gietler.command import command


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    command(parser.add_subparsers())
    arguments = parser.parse_args(["gietler", *words])
    return int(arguments.run(arguments))


def test_converge_counts_runs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    figure = tmp_path / "converge.png"
    assert run("converge", "--runs", "1", "--seed", "4", "--json", "--figure", str(figure)) == 0
    rows = {row["filter"]: row for row in map(json.loads, capsys.readouterr().out.splitlines())}
    assert rows["iterated"]["converged"] == 1
    assert rows["plain"]["converged"] == 0
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_track_prints_a_table_and_draws(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    figure = tmp_path / "track.png"
    assert run("track", "--runs", "1", "--material", "copper", "--figure", str(figure)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[2:]] == [
        ["copper", "base"],
        ["copper", "base,"],
        ["copper", "extended"],
    ]
    assert figure.stat().st_size > 10_000


def test_table_shows_that_the_printed_one_is_not_reproduced(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("table", "--json") == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    ours = {(row["table"], row["emitter"], row["source"]): row for row in rows}
    first = ours["I", 1, "boundary elements, perfect conductor"]
    assert first["cosine"] == pytest.approx(-0.996, abs=0.002)
    assert 1.0 / first["ratio"] == pytest.approx(0.56, abs=0.02)
    explicit = ours["I", 1, "explicit formula"]
    assert explicit["ratio"] == pytest.approx(first["ratio"], rel=0.08)


def test_cube_without_reference_is_refused() -> None:
    with pytest.raises(UserError, match="no reference solution of a cube of carbon"):
        run("track", "--body", "cube", "--material", "carbon")


def test_table_has_no_figure(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nothing to draw"):
        run("table", "--figure", str(tmp_path / "t.png"))


@pytest.mark.parametrize(
    "words", [("converge", "--runs", "0"), ("track", "--noise", "-1"), ("table", "--frequency", "x")]
)
def test_bad_options_are_refused(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run(*words)
    assert "argument --" in capsys.readouterr().err

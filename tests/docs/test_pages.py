"""Each page with commands to be run: they end as it says, and print what it quotes.

`test_new_room.py` and `test_start.py` run two of the pages themselves, and look at what they make besides.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from hil_sim.clib import ROOT
from tests.docs import walkthrough
from tests.docs.quotation import agrees, not_printed

ELSEWHERE = ("new_room.md", "start.md")
MOVES = "goldfield hil walk8 --boards host --true-site exact.toml --truth truth.jsonl --link ./sensor --wait"
"""The command of the tutorial behind which its benches take most of the time."""
PAGES = [
    name
    for path in sorted((ROOT / "docs").rglob("*.md"))
    for name in [path.relative_to(ROOT / "docs").as_posix()]
    if name not in ELSEWHERE and walkthrough.blocks(name, "sh")
]


def test_the_tutorial_is_run() -> None:
    assert "tutorial.md" in PAGES
    assert MOVES in [command for command, _ in walkthrough.steps("tutorial.md")]
    assert all(walkthrough.blocks(name, "sh") for name in ELSEWHERE)


@pytest.mark.parametrize("name", PAGES)
def test_what_a_page_says_happens(name: str, tmp_path: Path) -> None:
    """The tutorial up to where its sensor moves."""
    assert not_printed(walkthrough.run_page(name, tmp_path, until=MOVES)) == []


@pytest.mark.slow
def test_what_the_whole_tutorial_says_happens(tmp_path: Path) -> None:
    assert not_printed(walkthrough.run_page("tutorial.md", tmp_path)) == []


@pytest.mark.parametrize(
    ("printed", "same"),
    [
        ("b1 is 1.52 m away", True),
        ("b1 is 1.70 m away", True),
        ("b1 is 1.90 m away", False),
        ("b1 is 1.52 m near", False),
        ("b1 is -1.52 m away", False),
        ("b1 is 1.52 m away, b2 is 3 m away", False),
    ],
)
def test_a_quotation_is_compared(printed: str, same: bool) -> None:
    assert agrees("b1 is 1.52 m away", printed) == same


@pytest.mark.parametrize(
    ("printed", "same"), [("b1 is 1.60 m away, b2 is 3 m away", True), ("b1 is 2 m away", False), ("b1 is", False)]
)
def test_a_quotation_is_compared_as_far_as_it_goes(printed: str, same: bool) -> None:
    assert agrees("b1 is 1.52 m away ...", printed) == same


def test_a_quotation_that_was_not_printed_is_found() -> None:
    step = walkthrough.Step("goldfield x", "one\ntwo 3\n", ("two 3", "three"))
    assert not_printed([step]) == ["goldfield x\n    three"]


def test_a_wrong_exit_code_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "```sh\ngoldfield locate --site none.toml none.csv{}\n```\n"
    monkeypatch.setattr(walkthrough, "page", lambda name: text.format("  # exits with 2: there is no site file"))
    (step,) = walkthrough.run_page("a.md", tmp_path)
    assert "none.toml" in step.printed
    monkeypatch.setattr(walkthrough, "page", lambda name: text.format(""))
    with pytest.raises(RuntimeError, match="ended with 2"):
        walkthrough.run_page("a.md", tmp_path)

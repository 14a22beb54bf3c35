"""The site of the documentation: how its pages are laid out, what is generated, and that a lost link is found."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import goldfield
from hil_sim.clib import ROOT

sys.path.insert(0, str(ROOT / "docs/site"))
stage = importlib.import_module("stage")
generated = importlib.import_module("generated")
check_links = importlib.import_module("check_links")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    (folder / "gone.md").write_text("a page that was removed from the tree")
    subprocess.run([sys.executable, ROOT / "docs/site/stage.py", folder], check=True)
    return folder


def test_the_pages_are_laid_out(site):
    assert {"index.md", "start.md", "goldfield.svg"} <= {path.name for path in site.iterdir()}
    assert (site / "protocol/framing.md").is_file()
    assert not (site / "gone.md").exists()
    index = (site / "index.md").read_text()
    assert "](start.md)" in index
    assert "](protocol/framing.md)" in index
    assert "](../parameters.md)" not in (site / "start.md").read_text()
    assert "](../parameters.md)" in (site / "protocol/framing.md").read_text()


def test_each_page_is_in_the_navigation_once():
    pages = stage.pages()
    named = stage.navigation(pages).splitlines()
    for page in set(pages) - {stage.FIRST}:
        assert named.count(stage.staged(page)) == 1, page


def test_a_new_page_is_in_the_navigation_and_a_lost_one_is_refused():
    pages = stage.pages()
    assert "More" not in stage.navigation(pages)
    assert "More\n\nnew.md\n" in stage.navigation(pages | {"docs/new.md": "# New\n"})
    with pytest.raises(stage.StageError, match=r"host/lost\.md: no navigation reaches it"):
        stage.navigation(pages | {"host/lost.md": "# Lost\n"})


def test_a_link_to_nothing_is_refused():
    with pytest.raises(stage.StageError, match=r"docs/cli\.md: the link gone\.md leads to nothing"):
        stage.rewritten("[a](gone.md)", "docs/cli.md", {})


@pytest.mark.parametrize(
    ("text", "on_the_site"),
    [
        ("[`cli.md`](cli.md)", "[The command line](cli.md)\n"),
        ("[the files](cli.md#files)", "[the files](cli.md#files)\n"),
        ("[`framing.md`](../protocol/framing.md#budget)", "[`framing.md`](protocol/framing.md#budget)\n"),
        ("```\n[a](gone.md)\n```", "```\n[a](gone.md)\n```\n"),
        ("[x](https://example.org/a.md) [y](#below)", "[x](https://example.org/a.md) [y](#below)\n"),
    ],
)
def test_links_are_rewritten(text, on_the_site):
    assert stage.rewritten(text, "docs/start.md", {"docs/cli.md": "The command line"})[0] == on_the_site


def test_every_option_is_in_the_reference(site):
    text = (site / "commands.md").read_text()
    for command, options in {"run": ("--port PATH", "--lag [MS]"), "nodes set": (), "hil": ("--pace",)}.items():
        part = text.split(f"# goldfield {command}\n")[1].split("\n#")[0]
        assert "```text\ngoldfield" in part
        for option in options:
            assert f"`{option}" in part


def test_every_message_and_signal_is_in_the_reference(site):
    text = (site / "messages.md").read_text()
    dbc = generated.MESSAGES.read_text()
    for line in dbc.splitlines():
        if line.startswith("BO_ "):
            part = text.split(f"\n## {line.split()[2].rstrip(':')}\n")[1].split("\n## ")[0]
        elif line.startswith(" SG_ "):
            assert f"| `{line.split()[1]}` |" in part


def test_the_page_of_public_names_has_each_once():
    page = (ROOT / "docs/api.md").read_text()
    names = [name for _, words in stage.GENERATED.findall(page) for name in words.split()]
    assert sorted([*names, "__version__"]) == sorted(goldfield.__all__)


def test_links_of_a_built_site_are_followed(tmp_path):
    (tmp_path / "index.html").write_text('<h1 id="top"></h1><a href="a.html#one"></a><a href="#top"></a>')
    (tmp_path / "a.html").write_text('<p id="one"></p><img src="https://example.org/x.png">')
    assert check_links.broken_links(tmp_path) == []
    (tmp_path / "a.html").write_text('<p id="two"></p><a href="index.html#gone"></a><img src="no.png">')
    (tmp_path / "alone.html").write_text("")
    assert check_links.broken_links(tmp_path) == [
        "a.html: index.html#gone",
        "a.html: no.png",
        "index.html: a.html#one",
        "alone.html: no other page links to it",
    ]

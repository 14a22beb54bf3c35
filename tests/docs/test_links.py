"""What the Markdown files name is there: relative links, and the paths, files and make targets between back-ticks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOP = ("docs", "firmware", "hil_sim", "host", "protocol", "tests", ".ci")
FILES = [path for top in TOP for path in (ROOT / top).rglob("*") if path.is_file()]
PLACES = [
    f"/{path.relative_to(ROOT).as_posix()}"
    for path in (*ROOT.iterdir(), *(p for top in TOP for p in (ROOT / top).rglob("*")))
]
DOCUMENTS = sorted(
    path for path in (*FILES, *ROOT.glob("*.md")) if path.suffix == ".md" and "third_party" not in path.parts
)

LINK = re.compile(r"\]\(([^)\s]+)\)")
QUOTED = re.compile(r"``+.*?``+|`([^`\n]+)`")
PATH = re.compile(r"\.{0,2}/?[\w.-]+(/[\w.*-]+)*/?")
SOURCE = (".py", ".c", ".h", ".mk", ".dbc", ".md", ".pyi", ".svg", ".png")
"""Endings of files that are the tree's own; a TOML or CSV file without a folder may be the reader's."""

MADE = ("build/", ".venv/", "/dev/")
"""What the build makes, and devices."""


def make_targets() -> set[str]:
    """Return the targets of all make files."""
    texts = [
        path.read_text() for path in (ROOT / "Makefile", *FILES) if path.name == "Makefile" or path.suffix == ".mk"
    ]
    return {
        target
        for text in texts
        for targets in re.findall(r"^([\w .-]+?)\s*:(?!=)", text, re.M)
        for target in targets.split()
    }


def exists(name: str, folder: Path) -> bool:
    """Tell whether a path is in the tree: from the document's folder, or as the end of any path of the tree.

    A README may so leave out the folders above its own. NAME and ``*`` stand for any name.
    """
    pattern = re.escape(name.rstrip("/")).replace("NAME", r"[^/]+").replace(r"\*", r"[^/]+")
    return (folder / name).exists() or any(re.search(f"/{pattern}$", place) for place in PLACES)


def is_path(name: str) -> bool:
    """Tell whether what stands between back-ticks is a path or a file of the tree."""
    if not PATH.fullmatch(name) or name.startswith(MADE):
        return False
    return name.endswith(SOURCE) or name.endswith("/") or ("/" in name and name.split("/")[0] in TOP)


def missing(text: str, folder: Path) -> Iterator[str]:
    """Yield the links, paths and make targets of a Markdown text that are not there.

    A block whose first line is a comment with a file's name is saved by the reader under this name.
    """
    saved = set(re.findall(r"^```\w+\n# ([\w-]+\.\w+)$", text, re.M))
    for link in LINK.findall(text):
        if "://" not in link and not (folder / link.partition("#")[0]).exists():
            yield f"link {link}"
    for quoted in filter(None, QUOTED.findall(text)):
        command = re.match(r"make ([a-z][\w-]*)$", re.sub(r"( [A-Z_]+=\S+)+$", "", quoted))
        if command and command[1] not in make_targets():
            yield f"`{quoted}`"
        for word in quoted.split():
            name = word.rstrip(",:;")
            if is_path(name) and name not in saved and not exists(name, folder):
                yield f"`{word}`"


def test_the_documents_were_found():
    assert {"README.md", "docs/cli.md", "host/README.md"} <= {p.relative_to(ROOT).as_posix() for p in DOCUMENTS}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_what_a_document_names_is_there(path):
    assert list(missing(path.read_text(), path.parent)) == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[a](cli.md) `host/goldfield/cli/run.py` `core/codes/` `hal.h` `make test` `site.toml`", 0),
        ("`build/firmware/x.elf` `https://a.b/c.py` `a/b` [b](https://a.b/c)", 0),
        ("`pytest -s tests/docs/test_links.py` `lockstep.*`", 0),
        ("`gone.py`\n```python\n# gone.py\n```", 0),
        ("[a](gone.md)", 1),
        ("`host/goldfield/cli/gone.py`", 1),
        ("`core/gone/`", 1),
        ("`gone.h`", 1),
        ("`make gone`", 1),
        ("`make gone ROLE=sensor`", 1),
        ("`pytest -s tests/hil/test_gone.py`", 1),
    ],
)
def test_the_checker_judges_both_ways(text, found):
    assert len(list(missing(text, ROOT / "docs"))) == found

"""Lay the pages of the documentation out for Sphinx: ``python docs/site/stage.py FOLDER``.

The pages are the Markdown files of the tree as they are: those of ``docs``, and those of other folders to which they
link. In FOLDER the pages of ``docs`` lie at the top, and `docs/README.md` is the first page, with the navigation made
of its own sections. Links are rewritten to where their targets lie; ``<!-- generated: NAME ... -->`` in a page is
replaced by what `generated.GENERATORS` makes.
"""

from __future__ import annotations

import os
import posixpath
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import generated

ROOT = Path(__file__).resolve().parents[2]
FIRST = "docs/README.md"
LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")
NAMED_AFTER_FILE = re.compile(r"\[`[\w./-]+(?:\.md|/)`\](?=\(([^)#\s]+))")
"""The text of a link that is the name of a file or a folder; on the site the title of the page takes its place."""
GENERATED = re.compile(r"^<!-- generated: (\w+)(.*?) -->$", re.M)


class StageError(Exception):
    """A link to nothing, or a page that no navigation reaches."""


def staged(path: str) -> str:
    """Return where a file of the tree lies in the folder of the site."""
    return "index.md" if path == FIRST else path.removeprefix("docs/")


def target_of(link: str, page: str) -> str:
    """Return the file of the tree to which a link of a page leads; a folder stands for its README.

    Raises
    ------
    StageError
        If there is no such file.
    """
    path = posixpath.normpath(posixpath.join(posixpath.dirname(page), link))
    if (ROOT / path).is_dir():
        path = f"{path}/README.md"
    if path.startswith("..") or not (ROOT / path).is_file():
        raise StageError(f"{page}: the link {link} leads to nothing that the site could show")
    return path


def prose_lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines outside fenced blocks, with their numbers from 0 on."""
    fenced = False
    for number, line in enumerate(text.splitlines()):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced:
            yield number, line


def links_of(text: str) -> list[str]:
    """Return the links of a page into the tree, without their anchors."""
    found = [link for _, line in prose_lines(text) for link in LINK.findall(line)]
    return [link.partition("#")[0] for link in found if "://" not in link and not link.startswith("#")]


def pages() -> dict[str, str]:
    """Return the text of each page by its path in the tree: those of ``docs``, and all to which a page links."""
    waiting = [path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").rglob("*.md"))]
    found: dict[str, str] = {}
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found[path] = (ROOT / path).read_text(encoding="utf-8")
        targets = [target_of(link, path) for link in links_of(found[path])]
        waiting += [target for target in targets if target.endswith(".md")]
    return found


def sections(text: str) -> dict[str, list[str]]:
    """Return the pages to which the tables of each section of the first page link, in their order."""
    found: dict[str, list[str]] = {}
    title = ""
    for _, line in prose_lines(text):
        if line.startswith("## "):
            title = line.removeprefix("## ")
        elif line.startswith("| ") and title:
            found.setdefault(title, []).extend(links_of(line.split("|")[1]))
    return {
        title: [target for target in (target_of(link, FIRST) for link in links) if target.endswith(".md")]
        for title, links in found.items()
    }


def navigation(found: dict[str, str]) -> str:
    """Return the navigation as Markdown: a list of pages for each section of the first page.

    A page of ``docs`` itself that no section has, as a new one, comes last.

    Raises
    ------
    StageError
        If a page of another folder is in no section.
    """
    parts = sections(found[FIRST])
    listed = {FIRST}.union(*parts.values())
    left = sorted(set(found) - listed)
    new = [path for path in left if posixpath.dirname(path) == "docs"]
    if lost := [path for path in left if path not in new]:
        raise StageError(f"no section of {FIRST} names {', '.join(lost)}: no navigation reaches it")
    if new:
        parts["More"] = new
    blocks = [
        "\n".join(["```{toctree}", ":hidden:", f":caption: {title}", "", *map(staged, paths), "```"])
        for title, paths in parts.items()
    ]
    return "\n\n" + "\n\n".join(blocks) + "\n"


def rewritten(text: str, page: str, titles: dict[str, str]) -> tuple[str, list[str]]:
    """Return a page with its links as the site has them, and the files of the tree to which they lead."""
    files: list[str] = []
    lines = text.splitlines()

    def titled(match: re.Match[str]) -> str:
        title = titles.get(target_of(match[1], page))
        return f"[{title}]" if title else match[0]

    def moved(match: re.Match[str]) -> str:
        link, hash_mark, anchor = match[1].partition("#")
        if "://" in match[1] or not link:
            return match[0]
        target = target_of(link, page)
        files.append(target)
        where = os.path.relpath(staged(target), posixpath.dirname(staged(page)) or ".")
        return f"]({where}{hash_mark}{anchor})"

    for number, line in prose_lines(text):
        lines[number] = LINK.sub(moved, NAMED_AFTER_FILE.sub(titled, line))
    return "\n".join(lines) + "\n", files


def stage(folder: Path) -> None:
    """Write the pages, and the pictures and files to which they link, and remove what else is in the folder."""
    found = pages()
    titles = {page: text.splitlines()[0].removeprefix("# ") for page, text in found.items()}
    written: set[Path] = set()
    for page, text in found.items():
        moved, files = rewritten(text, page, titles)
        moved = GENERATED.sub(lambda match: generated.GENERATORS[match[1]](*match[2].split()), moved)
        if page == FIRST:
            moved += navigation(found)
        written.add(_write(folder / staged(page), moved.encode()))
        written |= {_write(folder / staged(file), (ROOT / file).read_bytes()) for file in files if file not in found}
    for path in folder.rglob("*"):
        if path.is_file() and path not in written:
            path.unlink()


def _write(path: Path, content: bytes) -> Path:
    """Write a file unless it holds this already: Sphinx reads again what is newer."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_bytes() != content:
        path.write_bytes(content)
    return path


if __name__ == "__main__":
    try:
        stage(Path(sys.argv[1]))
    except StageError as error:
        sys.exit(str(error))

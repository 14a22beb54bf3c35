"""Which module imports which, read from the sources: imports inside functions and under TYPE_CHECKING included."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

Graph = Mapping[str, frozenset[str]]
"""For each module the modules of the same tree that it imports."""


@dataclass(frozen=True)
class Import:
    """One imported name: ``target`` is the full dotted name, ``line`` where it stands, ``typing_only`` why."""

    module: str
    target: str
    line: int
    typing_only: bool


def sources(root: Path, package: str) -> dict[str, Path]:
    """Return the file of each module of a package, by dotted name."""
    found = {}
    for path in sorted((root / package).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(module: str, path: Path) -> Iterator[Import]:
    """Yield every name that a module imports, wherever the statement stands."""
    tree = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and _names_type_checking(node.test)
        for statement in node.body
        for inner in ast.walk(statement)
    }
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = _base(node, package)
            targets = [base if alias.name == "*" else f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        for target in targets:
            yield Import(module, target, node.lineno, id(node) in typing_only)


def _names_type_checking(test: ast.expr) -> bool:
    return any(
        (isinstance(node, ast.Name) and node.id == "TYPE_CHECKING")
        or (isinstance(node, ast.Attribute) and node.attr == "TYPE_CHECKING")
        for node in ast.walk(test)
    )


def _base(node: ast.ImportFrom, package: str) -> str:
    """Return the dotted name that ``from ... import`` takes from, relative ones resolved."""
    if node.level == 0:
        return node.module or ""
    parts = package.split(".")
    start = ".".join(parts[: len(parts) - (node.level - 1)])
    return f"{start}.{node.module}" if node.module else start


def graph(modules: Iterable[str], found: Iterable[Import]) -> Graph:
    """Return the module graph: a name counts for the longest module that it begins with.

    The package that holds a module is not counted as imported by it: only what the source says counts.
    """
    known = set(modules)
    edges: dict[str, set[str]] = {module: set() for module in known}
    for item in found:
        name = item.target
        while name and name not in known:
            name = name.rpartition(".")[0]
        if name:
            edges[item.module].add(name)
    return {module: frozenset(targets) for module, targets in edges.items()}


def circles(edges: Graph) -> list[list[str]]:
    """Return the strongly connected components that are circles: of two modules or more, or one importing itself."""
    reached = {module: _reachable(edges, module) for module in edges}
    found = {
        tuple(sorted(other for other in reached[module] if module in reached[other]))
        for module in edges
        if module in reached[module]
    }
    return [list(circle) for circle in sorted(found)]


def _reachable(edges: Graph, start: str) -> set[str]:
    seen: set[str] = set()
    waiting = list(edges[start])
    while waiting:
        module = waiting.pop()
        if module not in seen:
            seen.add(module)
            waiting.extend(edges[module])
    return seen

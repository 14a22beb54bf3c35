"""The import rules of the tree, and how much may lie loose at the top of a package."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from tests.structure.import_graph import Import, circles, graph, imports, sources

ROOT = Path(__file__).parents[2]
PACKAGES = {"goldfield": ROOT / "host", "goldfield_protocol": ROOT / "protocol", "hil_sim": ROOT}

MODULES = {module: path for package, root in PACKAGES.items() for module, path in sources(root, package).items()}


@cache
def all_imports() -> list[Import]:
    """Read the imports of all modules: once, and not while tests are collected, which every worker does."""
    return [item for module, path in MODULES.items() for item in imports(module, path)]


LEVELS = (
    ("errors",),
    ("types",),
    ("files",),
    ("link",),
    ("site",),
    ("access", "field"),
    ("locate",),
    ("track", "survey", "calibration", "planning"),
    ("sensor",),
    ("nodes",),
    ("update",),
    ("doctor",),
    ("view",),
    ("foxglove",),
    ("page", "recording", "feeds"),
    ("cli",),
)
"""Parts of goldfield, lowest first. A part imports itself and lower ones; parts of one level do not know each other.

The files are lowest, since a recording of a link is one; a link knows no site, and a site knows no link.
"""

LEVEL = {part: level for level, parts in enumerate(LEVELS) for part in parts}
NEVER = {("site", "link")}
"""Downward or level, and still forbidden."""

TYPING_ONLY = {
    "goldfield.cli.live": "goldfield.page",
    "goldfield.cli.entry": "importlib.metadata",
    "goldfield.update.keys": "cryptography",
    "goldfield.cli.page_option": "goldfield.page",
    "goldfield.cli.surveying": "goldfield.cli.page_progress",
    "hil_sim.papers.plot": "matplotlib",
    "hil_sim.papers.prigge.waveforms": "matplotlib",
}
"""Imports for annotations alone, each with its reason: an optional package that only pictures need, or what is loaded
only if a page or a command of another package is asked for."""


def within(name: str, *packages: str) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def part_of(name: str) -> str | None:
    """Return the part of goldfield that a module or an imported name belongs to; None: the front door or no part."""
    first, *rest = name.split(".")
    return rest[0] if first == "goldfield" and rest and rest[0] in LEVEL else None


def breaks_layers(item: Import) -> bool:
    """Tell whether an import inside goldfield goes up, or to another part of the same level."""
    here, there = part_of(item.module), part_of(item.target)
    if here is None or there is None or here == there:
        return False
    return LEVEL[there] >= LEVEL[here] or (here, there) in NEVER


def complaints(found: list[Import]) -> list[str]:
    return [f"{item.module}:{item.line} imports {item.target}" for item in found]


def forbidden(importer: tuple[str, ...], imported: tuple[str, ...], but: tuple[str, ...] = ()) -> list[str]:
    """Return the imports of some packages, except in the modules of ``but``, by others."""
    return complaints(
        [
            item
            for item in all_imports()
            if within(item.module, *importer) and not within(item.module, *but) and within(item.target, *imported)
        ]
    )


def test_the_tree_was_read():
    assert {"goldfield.cli", "goldfield.locate.fit", "goldfield_protocol.messages", "hil_sim.rig.rig"} <= set(MODULES)
    assert len(all_imports()) > 500


def test_every_part_of_goldfield_has_a_level():
    parts = {module.split(".")[1] for module in MODULES if module.startswith("goldfield.")}
    assert parts - set(LEVEL) == {"__main__"}


@pytest.mark.parametrize(
    ("module", "target", "bad"),
    [
        ("goldfield.track.filter", "goldfield.locate.fit.Fit", False),
        ("goldfield.locate.fit", "goldfield.track.Tracker", True),
        ("goldfield.field.model", "goldfield.access.cdma", True),
        ("goldfield.access.cdma", "goldfield.field.model", True),
        ("goldfield.access.epoch", "goldfield.link.reports", False),
        ("goldfield.link.recordings", "goldfield.files.outputs", False),
        ("goldfield.files.outputs", "goldfield.link.recordings", True),
        ("goldfield.site.reading", "goldfield.link.buses", True),
        ("goldfield.types", "goldfield.errors.UserError", False),
        ("goldfield.errors", "goldfield.types.Pose", True),
        ("goldfield.cli.run", "goldfield.view.terminal", False),
        ("goldfield.view.terminal", "goldfield.cli.options", True),
        ("goldfield.sensor.session", "goldfield.view.truth", True),
        ("goldfield", "goldfield.sensor.session", False),
    ],
)
def test_the_rule_of_layers_judges_both_ways(module, target, bad):
    assert breaks_layers(Import(module, target, 1, False)) == bad


def test_imports_of_goldfield_go_down():
    assert complaints([item for item in all_imports() if breaks_layers(item)]) == []


def test_nothing_below_takes_from_the_front_door():
    """``from goldfield import site`` names a part; ``from goldfield import Pose`` would close a circle."""
    parts = {"goldfield.__version__", *(module for module in MODULES if within(module, "goldfield"))}
    inside = [item for item in all_imports() if part_of(item.module) not in (None, "cli")]
    assert (
        complaints(
            [i for i in inside if i.target.count(".") <= 1 and within(i.target, "goldfield") and i.target not in parts]
        )
        == []
    )


def test_the_protocol_knows_neither_host_nor_simulator():
    assert forbidden(("goldfield_protocol",), ("goldfield", "hil_sim")) == []


def test_the_host_never_imports_the_simulator():
    assert forbidden(("goldfield",), ("hil_sim",)) == []


MODELS = ("goldfield.locate", "goldfield.field", "goldfield.access")


def test_the_worlds_physics_is_independent_of_the_hosts_model():
    assert forbidden(("hil_sim.world", "hil_sim.emulator"), (*MODELS, "hil_sim.rig")) == []


def test_world_and_model_meet_in_the_papers_alone():
    assert forbidden(("hil_sim",), MODELS, but=("hil_sim.papers",)) == []
    assert forbidden(("goldfield", "hil_sim"), ("hil_sim.papers",), but=("hil_sim.papers",)) == []


def test_no_circle():
    assert circles(graph(MODULES, all_imports())) == []


def test_imports_for_typing_have_a_reason():
    found = [item for item in all_imports() if item.typing_only]
    assert complaints([i for i in found if not within(i.target, TYPING_ONLY.get(i.module, "nothing"))]) == []


MOST_LINES = 60
"""A function is a screen, its docstring included."""


def long_functions(source: str) -> list[str]:
    return [
        f"{node.name}: {(node.end_lineno or 0) - node.lineno + 1} lines"
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or 0) - node.lineno >= MOST_LINES
    ]


def test_a_function_of_one_line_more_is_too_long():
    assert long_functions("def fits():\n" + "    pass\n" * (MOST_LINES - 1)) == []
    assert len(long_functions("class A:\n  async def long(self):\n" + "    pass\n" * MOST_LINES)) == 1


def test_no_function_is_longer_than_a_screen():
    found = {module: long_functions(path.read_text()) for module, path in MODULES.items()}
    assert {module: functions for module, functions in found.items() if functions} == {}


@pytest.mark.parametrize(("package", "most"), [("goldfield", 4), ("hil_sim", 6)])
def test_few_files_lie_loose_at_the_top(package, most):
    loose = [path.name for path in (PACKAGES[package] / package).glob("*.py")]
    assert len(loose) <= most, sorted(loose)

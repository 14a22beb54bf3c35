"""The shape of the C code: modules that depend in one direction, folders that keep to themselves, short functions.

A module is what stands in one folder under one name: ``x.c``, ``x.h``, ``x_internal.h``, and ``x_part.c`` where that
has no header of its own. It depends on another module if it includes a header of it or names a function that the other
defines. The functions of a contract (`CONTRACTS`) are defined by several boards: who calls them depends on the
contract.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
KERNEL = "host/goldfield/locate/kernel"
BANK = "host/goldfield/track/blocks/kernel"
INCLUDE_PATHS = ("firmware", "hil_sim", KERNEL, BANK)
GENERATED = {
    "goldfield.h",
    "protocol_hash.h",
    "parameter_ids.h",
    "parameter_table.h",
    "counter_ids.h",
    "message_table.h",
    "link_rates.h",
}
"""Headers that the build makes from the protocol's tables."""
THIRD_PARTY = "firmware/third_party/"
"""What others have written, which only these may include."""
THIRD_PARTY_USERS = ("firmware/core/boot/image", "firmware/core/link/challenge")
CONTRACTS = ("firmware/hal/hal.h", "firmware/boards/board.h")
LONGEST = 60

EDGE = "firmware/boards/board_edge.h"
ALLOWED: Mapping[str, tuple[str, ...]] = {
    "firmware/core": (),
    "firmware/hal": (),
    "firmware/services": ("firmware/core", "firmware/hal"),
    "firmware/apps": ("firmware/core", "firmware/hal", "firmware/services"),
    "firmware/images": ("firmware/apps", "firmware/boards/board.h"),
    "firmware/boards/board": ("firmware/hal",),
    "firmware/boards/stm32f405": ("firmware/hal", "firmware/boards/board.h"),
    "firmware/boards/stm32f405/boot": ("firmware/core", "firmware/hal", "firmware/boards/stm32f405"),
    "firmware/boards/host": ("firmware/hal", "firmware/apps", EDGE),
    "hil_sim/world": (),
    "hil_sim/emulator": (EDGE,),
    "hil_sim/rig": ("hil_sim/world", EDGE),
    KERNEL: (),
    BANK: ("firmware/core", f"{KERNEL}/linear.h"),
}
"""What a folder includes beside itself."""

Files = Mapping[str, str]


def read_tree() -> dict[str, str]:
    """Return the C files of the product by path, without those of others."""
    paths = (p for top in ("firmware", "hil_sim", KERNEL, BANK) for p in (ROOT / top).rglob("*.[ch]"))
    found = {p.relative_to(ROOT).as_posix(): p.read_text() for p in sorted(paths)}
    return {path: text for path, text in found.items() if not path.startswith(THIRD_PARTY)}


def plain(text: str) -> str:
    """Return C text without comments, strings and attributes."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.S)
    text = re.sub(r'^(#include ")|"(?:\\.|[^"\\\n])*"', lambda m: m[1] or '""', text, flags=re.M)
    return re.sub(r"__attribute__\s*\(\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\)\)\s*", "", text)


def definitions(text: str) -> dict[str, bool]:
    """Return the functions that plain C text defines, and whether others can call them (they are not static)."""
    found = re.finditer(r"^([A-Za-z_][\w\s*]*?)\b(\w+)\(([^;{}]*)\)\s*\{", text, re.M)
    return {m[2]: "static" not in m[1].split() for m in found}


def modules(files: Iterable[str]) -> dict[str, str]:
    """Return the module of each file: its path without suffix, or that of the header whose part it is."""
    headers = {re.sub(r"(_internal)?\.h$", "", f) for f in files if f.endswith(".h")}
    result = {}
    for path in files:
        stem = re.sub(r"(_internal)?\.[ch]$", "", path)
        name = stem.rpartition("/")[2]
        owners = (stem[: len(stem) - n] for n in range(len(name)) if n == 0 or stem[len(stem) - n] == "_")
        result[path] = next((owner for owner in owners if owner in headers), stem)
    return result


def included(path: str, text: str, files: Files) -> list[str]:
    """Return the paths of the headers of ours that a file includes.

    Raises
    ------
    AssertionError
        A header that is neither in the tree nor generated.
    """
    result = []
    for name in re.findall(r'^#include "([^"]+)"', text, re.M):
        places = [f"{top}/{name}" for top in INCLUDE_PATHS] + [f"{path.rpartition('/')[0]}/{name}"]
        hit = next((place for place in places if place in files), None)
        if hit is None and f"firmware/{name}".startswith(THIRD_PARTY) and path.startswith(THIRD_PARTY_USERS):
            continue
        assert hit is not None or name in GENERATED, f"{path} includes {name}, which is nowhere"
        result += [hit] if hit is not None else []
    return result


def dependencies(files: Files) -> dict[str, dict[str, str]]:
    """Return for each module those that it depends on, with one reason each."""
    texts, module = {path: plain(text) for path, text in files.items()}, modules(files)
    defined = {path: definitions(text) for path, text in texts.items() if path.endswith(".c")}
    homes: dict[str, set[str]] = {}
    for path, functions in defined.items():
        for name, offered in functions.items():
            if offered:
                homes.setdefault(name, set()).add(module[path])
    for contract in CONTRACTS:
        for name in re.findall(r"\b(\w+)\(", texts.get(contract, "")):
            homes[name] = {module[contract]}
    graph: dict[str, dict[str, str]] = {}
    for path, text in texts.items():
        own = module[path]
        edges = graph.setdefault(own, {})
        for header in included(path, text, files):
            edges.setdefault(module[header], f"{path} includes {header}")
        if path.endswith(".c"):
            for name in sorted(set(re.findall(r"(?<![\w.>])[A-Za-z_]\w*", text)) - set(defined[path])):
                if len(homes.get(name, ())) == 1:
                    edges.setdefault(next(iter(homes[name])), f"{path} names {name}")
        edges.pop(own, None)
    return graph


def circle(graph: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the reasons along one circle of a graph; nothing if there is none."""
    finished: set[str] = set()
    for start in graph:
        way: list[tuple[str, str]] = [(start, "")]
        pending = [iter(graph[start].items())]
        while pending:
            step = next(pending[-1], None)
            if step is None:
                finished.add(way.pop()[0])
                pending.pop()
                continue
            target, reason = step
            names = [name for name, _ in way]
            if target in names:
                return [r for _, r in way[names.index(target) + 1 :]] + [reason]
            if target not in finished:
                way.append((target, reason))
                pending.append(iter(graph.get(target, {}).items()))
    return []


def broken_rules(files: Files) -> list[str]:
    """Return the includes that `ALLOWED` does not allow."""
    wrong = []
    for path, text in files.items():
        folder = max((f for f in ALLOWED if path.startswith((f + "/", f + ".", f + "_"))), key=len)
        for header in included(path, plain(text), files):
            if not header.startswith(tuple(f"{f}/" if "." not in f else f for f in (folder, *ALLOWED[folder]))):
                wrong.append(f"{path} includes {header}")
    return wrong


def long_functions(files: Files) -> list[str]:
    """Return the C functions of more than `LONGEST` lines; the code is laid out by clang-format."""
    result = []
    for path, text in files.items():
        start, lines = 0, text.splitlines()
        for number, line in enumerate(lines, start=1):
            if re.match(r"[A-Za-z_]", line) and not line.endswith(";"):
                start = start or number
            if line.startswith("}") or (line.endswith(";") and re.match(r"[A-Za-z_]", line)):
                if line == "}" and number - start + 1 > LONGEST:
                    result.append(f"{path}:{start}: {number - start + 1} lines")
                start = 0
    return result


@pytest.fixture(scope="module")
def tree() -> dict[str, str]:
    return read_tree()


def test_modules_depend_in_one_direction(tree: dict[str, str]) -> None:
    graph = dependencies(tree)
    assert len(graph) > 100
    assert "hil_sim/emulator/exceptions" in graph["hil_sim/emulator/cpu"]
    assert circle(graph) == []


def test_folders_keep_to_what_they_may_know(tree: dict[str, str]) -> None:
    assert broken_rules(tree) == []


def test_functions_fit_on_a_screen(tree: dict[str, str]) -> None:
    assert long_functions(tree) == []


def test_every_function_that_is_offered_is_used(tree: dict[str, str]) -> None:
    texts = {path: plain(text) for path, text in tree.items() if path.endswith(".c")}
    offered = {name: path for path, text in texts.items() for name, public in definitions(text).items() if public}
    users = {path: set(re.findall(r"\w+", text)) for path, text in texts.items()}
    others = [p for top in ("tests", "host", "hil_sim", "protocol") for p in (ROOT / top).rglob("*.py")]
    others += [p for p in (ROOT / "tests").rglob("*.[ch]")]
    outside = {word for p in others if p != Path(__file__).resolve() for word in re.findall(r"\w+", p.read_text())}
    unused = [
        f"{path}: {name}"
        for name, path in offered.items()
        if name != "main" and name not in outside and not any(name in u for p, u in users.items() if p != path)
    ]
    assert unused == []


SMALL = {
    "hil_sim/emulator/high.c": '#include "emulator/low.h"\nint high(void) {\n    return low();\n}\n',
    "hil_sim/emulator/high.h": "int high(void);\n",
    "hil_sim/emulator/low.c": '#include "emulator/low.h"\nint low(void) {\n    return 0; /* high() */\n}\n',
    "hil_sim/emulator/low.h": "int low(void);\n",
    "hil_sim/emulator/low_part.c": '#include "emulator/low.h"\nint part(void) {\n    return low();\n}\n',
    "hil_sim/world/coil.h": "int coil(void);\n",
}


def test_checker_lets_a_sound_tree_pass() -> None:
    graph = dependencies(SMALL)
    assert set(graph) == {"hil_sim/emulator/high", "hil_sim/emulator/low", "hil_sim/world/coil"}
    assert circle(graph) == []
    assert broken_rules(SMALL) == []
    assert long_functions(SMALL) == []


def test_checker_finds_a_circle_of_calls_and_one_of_includes() -> None:
    calls = SMALL | {"hil_sim/emulator/low.c": "int high(void);\nint low(void) {\n    return high();\n}\n"}
    assert "hil_sim/emulator/low.c names high" in circle(dependencies(calls))
    part = SMALL | {"hil_sim/emulator/low_part.c": "int part(void) {\n    return high();\n}\n"}
    assert "hil_sim/emulator/low_part.c names high" in circle(dependencies(part))
    includes = SMALL | {"hil_sim/emulator/low.h": '#include "emulator/high.h"\nint low(void);\n'}
    assert "hil_sim/emulator/low.h includes hil_sim/emulator/high.h" in circle(dependencies(includes))


def test_checker_finds_a_broken_rule_and_a_header_that_is_nowhere() -> None:
    upward = SMALL | {"hil_sim/world/coil.h": '#include "emulator/low.h"\n'}
    assert broken_rules(upward) == ["hil_sim/world/coil.h includes hil_sim/emulator/low.h"]
    with pytest.raises(AssertionError, match="nowhere"):
        broken_rules(SMALL | {"hil_sim/world/coil.h": '#include "world/path.h"\n'})


@pytest.mark.parametrize(("lines", "found"), [(LONGEST, 0), (LONGEST + 1, 1)])
def test_checker_counts_lines(lines: int, found: int) -> None:
    c = (
        "static int table[] = {\n"
        + "    1,\n" * 70
        + "};\n\nint f(int a,\n      int b) {\n"
        + "    a();\n" * (lines - 3)
        + "}\n"
    )
    assert len(long_functions({"x.c": c})) == found

"""The checker itself, on made-up packages: it must find what it is there to find."""

import textwrap

import pytest

from tests.structure.import_graph import circles, graph, imports, sources


def written(root, files):
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text))
    modules = sources(root, "made")
    found = [item for module, path in modules.items() for item in imports(module, path)]
    return found, graph(modules, found)


@pytest.mark.parametrize(
    "text",
    [
        "import made.b",
        "import made.b as other",
        "from made import b",
        "from made.b import name",
        "from made.b import *",
        "from . import b",
        "from .b import name",
        "def late():\n    from made.b import name\n",
        "class Late:\n    def late(self):\n        import made.b\n",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from made.b import name\n",
        "try:\n    import made.b\nexcept ImportError:\n    pass\n",
    ],
)
def test_every_way_to_import_is_seen(tmp_path, text):
    _, edges = written(tmp_path, {"made/__init__.py": "", "made/a.py": text, "made/b.py": ""})
    assert "made.b" in edges["made.a"]


def test_a_relative_import_in_a_package_starts_at_the_package(tmp_path):
    files = {
        "made/__init__.py": "",
        "made/sub/__init__.py": "from .x import name\nfrom ..b import name",
        "made/b.py": "",
    }
    _, edges = written(tmp_path, {**files, "made/sub/x.py": "from .. import b"})
    assert edges["made.sub"] == {"made.sub.x", "made.b"}
    assert edges["made.sub.x"] == {"made.b"}


def test_only_imports_for_typing_are_marked(tmp_path):
    text = """
        import typing
        from made.b import one
        if typing.TYPE_CHECKING:
            from made.b import two
        else:
            from made.b import three
    """
    found, _ = written(tmp_path, {"made/__init__.py": "", "made/a.py": text, "made/b.py": ""})
    assert {item.target.rpartition(".")[2] for item in found if item.typing_only} == {"two"}


def test_circles_are_found_wherever_they_hide(tmp_path):
    files = {
        "made/__init__.py": "",
        "made/a.py": "from made.b import name",
        "made/b.py": "def late():\n    from made import c\n",
        "made/c.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from made.a import Name\n",
        "made/d.py": "from made.a import name",
    }
    _, edges = written(tmp_path, files)
    assert circles(edges) == [["made.a", "made.b", "made.c"]]
    _, straight = written(tmp_path, {"made/c.py": ""})
    assert circles(straight) == []


def test_a_module_that_imports_itself_is_a_circle():
    assert circles({"a": frozenset({"a"}), "b": frozenset({"a"})}) == [["a"]]

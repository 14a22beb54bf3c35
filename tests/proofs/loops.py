"""Which loops count: a number goes up by one each turn to a bound that stays where it is, so that they end."""

from __future__ import annotations

import re
from pathlib import Path

import tree_sitter
import tree_sitter_c

LANGUAGE = tree_sitter.Language(tree_sitter_c.language())


def text(node: tree_sitter.Node) -> str:
    """Return what stands at a node."""
    return (node.text or b"").decode()


def below(node: tree_sitter.Node) -> list[tree_sitter.Node]:
    """Return a node and all below it."""
    return [node, *(each for child in node.children for each in below(child))]


def assigned(node: tree_sitter.Node) -> set[str]:
    """Return what is assigned, counted up or down, or has its address taken at a node and below it."""
    kinds = {"assignment_expression": "left", "update_expression": "argument"}
    found = [each.child_by_field_name(kinds[each.type]) for each in below(node) if each.type in kinds]
    taken = [each for each in below(node) if each.type == "pointer_expression" and text(each).startswith("&")]
    addresses = [each.child_by_field_name("argument") for each in taken]
    return {text(each) for each in [*found, *addresses] if each is not None}


def conjuncts(node: tree_sitter.Node) -> list[tree_sitter.Node]:
    """Return the conditions that a condition joins by ``&&``."""
    if node.type == "binary_expression" and text(node.children[1]) == "&&":
        return [*conjuncts(node.children[0]), *conjuncts(node.children[2])]
    return [node]


def function_of(node: tree_sitter.Node) -> tree_sitter.Node | None:
    """Return the function around a node."""
    while node.parent is not None and node.type != "function_definition":
        node = node.parent
    return node if node.type == "function_definition" else None


def name_of(function: tree_sitter.Node) -> str:
    """Return the name of a function's definition."""
    declarator = function.child_by_field_name("declarator")
    found = re.search(r"(\w+)\s*\(", text(declarator)) if declarator is not None else None
    return found[1] if found else ""


def stays(bound: str, loop: tree_sitter.Node, function: tree_sitter.Node) -> bool:
    """Whether a bound is a sum of numbers and names that the loop leaves alone, or behind a pointer to a constant."""
    body = loop.child_by_field_name("body")
    if body is None or assigned(body) & {bound, *re.findall(r"\w+", bound)}:
        return False
    if re.fullmatch(r"\w+( [-+] \w+)*", bound):
        return True
    base = re.match(r"\w+", bound)
    pattern = rf"\bconst \w+ \*(const )?{base[0]}\b" if base else "(?!)"
    return re.search(pattern, text(function)) is not None


def counts(loop: tree_sitter.Node) -> bool:
    """Whether a loop is ``for (...; i < bound; i++)`` in which nothing else changes ``i`` or the bound."""
    condition, update = loop.child_by_field_name("condition"), loop.child_by_field_name("update")
    body, function = loop.child_by_field_name("body"), function_of(loop)
    if loop.type != "for_statement" or condition is None or update is None or body is None or function is None:
        return False
    for each in conjuncts(condition):
        found = re.fullmatch(r"(\w+) < (.+)", text(each), re.S)
        if found and text(update) == f"{found[1]}++" and found[1] not in assigned(body):
            return stays(found[2], loop, function)
    return False


class Source:
    """The functions and loops of a C file."""

    def __init__(self, path: Path) -> None:
        tree = tree_sitter.Parser(LANGUAGE).parse(path.read_bytes())
        nodes = below(tree.root_node)
        self.lines = path.read_text().splitlines()
        self.functions = {name_of(each) for each in nodes if each.type == "function_definition"}
        """Names of what it defines."""
        self._loops = {
            each.start_point[0] + 1: each
            for each in nodes
            if each.type in ("for_statement", "while_statement", "do_statement")
        }

    def loops(self) -> list[int]:
        """Return the lines in which loops begin."""
        return sorted(self._loops)

    def function_at(self, line: int) -> str:
        """Return the name of the function around the loop in a line."""
        function = function_of(self._loops[line])
        return name_of(function) if function is not None else ""

    def counts(self, line: int) -> bool:
        """Whether the loop in a line counts."""
        return counts(self._loops[line])

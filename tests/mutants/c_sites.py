"""Rewrites C so that one build holds all mutants: each place asks `mutants.h` at run time which of them it is to be.

The grammar is tree-sitter's. Operands are computed once and all alternatives of a place work on their values, so that
the text grows in proportion; a place within another is rewritten within it. Only what is computed at run time is
changed: no initialiser of static data, no size of an array, no label of a case, no assertion of the compiler, no
preprocessor line. An alternative stands on a line of its own with its number in a comment, by which `c_build` finds
out which one the compiler refuses.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

import tree_sitter
import tree_sitter_c

from tests.mutants.mutant import Mutant, shortened

PARSER = tree_sitter.Parser(tree_sitter.Language(tree_sitter_c.language()))
CONSTANT_NAME = re.compile(r"[A-Z][A-Z0-9_]+")
OTHER = {"+": "-", "-": "+", "*": "/", "/": "*", "%": "*", "<<": ">>", ">>": "<<", "&": "|", "|": "&", "^": "|"}
"""What an operator becomes."""
BOUNDARY = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
FARTHER = {"<": "-", "<=": "+", ">": "+", ">=": "-"}
"""Where a constant on the right of a comparison goes, so that its other side is tested too."""
MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
COMPARISONS = (*BOUNDARY, "==", "!=")
VERBATIM = {
    "sizeof_expression",
    "offsetof_expression",
    "alignof_expression",
    "type_descriptor",
    "string_literal",
    "char_literal",
    "preproc_def",
    "preproc_function_def",
    "preproc_include",
    "gnu_asm_expression",
    "subscript_designator",
    "field_designator",
    "parameter_list",
    "comment",
    "enum_specifier",
    "struct_specifier",
}
LOOPS = ("while_statement", "do_statement", "for_statement")


class Instrumented:
    """One source, rewritten; `text` is what to compile and `mutants` what it holds.

    Parameters
    ----------
    file : str
        Name of the source.
    source : bytes
        Its text.
    first : int
        Number of the first mutant.
    left_out : collection of (int, str)
        Places, by offset, and alternatives that are not to be made, because the compiler refuses them.
    """

    def __init__(self, file: str, source: bytes, first: int = 1, left_out: Iterable[tuple[int, str]] = ()):
        self.file, self.mutants = file, []
        self.places: dict[int, tuple[int, str]] = {}
        self._source, self._next, self._left_out = source, first, frozenset(left_out)
        self._function = ""
        self.text = self._node(PARSER.parse(source).root_node)

    # ---- mutants ----
    def _add(self, node: tree_sitter.Node, change: str, real: bool | None = None, shown: str = "") -> int | None:
        """Return the number of a new mutant, or None if there is to be none."""
        place = (node.start_byte, f"{node.type} {change}")
        if not self._function or place in self._left_out:
            return None
        number, self._next = self._next, self._next + 1
        self.places[number] = place
        what = f"`{shortened(shown or self._raw(node))}` {change}"
        self.mutants.append(Mutant(number, self.file, self._function, node.start_point[0] + 1, what, real))
        return number

    def _raw(self, node: tree_sitter.Node) -> str:
        return self._source[node.start_byte : node.end_byte].decode()

    # ---- text ----
    def _node(self, node: tree_sitter.Node) -> str:
        """Return the text of a node, rewritten."""
        if node.type in VERBATIM:
            return self._raw(node)
        special: Callable[[tree_sitter.Node], str] | None = getattr(self, f"_{node.type}", None)
        return special(node) if special else self._children(node)

    def _children(
        self, node: tree_sitter.Node, by_field: dict[str, Callable[[tree_sitter.Node], str]] | None = None
    ) -> str:
        """Return the text of a node whose children are rewritten, some fields of it in a way of their own."""
        parts, at = [], node.start_byte
        for i, child in enumerate(node.children):
            parts.append(self._source[at : child.start_byte].decode())
            way = (by_field or {}).get(node.field_name_for_child(i) or "", self._node)
            parts.append(way(child))
            at = child.end_byte
        parts.append(self._source[at : node.end_byte].decode())
        return "".join(parts)

    def _function_definition(self, node: tree_sitter.Node) -> str:
        name = node.child_by_field_name("declarator")
        while name is not None and name.type != "identifier":
            name = name.child_by_field_name("declarator")
        self._function = self._raw(name) if name is not None else "?"
        text = self._children(node, {"declarator": self._raw, "type": self._raw})
        self._function = ""
        return text

    def _declaration(self, node: tree_sitter.Node) -> str:
        static = any(c.type == "storage_class_specifier" and self._raw(c) == "static" for c in node.children)
        return self._raw(node) if static or not self._function else self._children(node)

    def _array_declarator(self, node: tree_sitter.Node) -> str:
        return self._raw(node)

    def _preproc_if(self, node: tree_sitter.Node) -> str:
        return self._children(node, {"condition": self._raw, "name": self._raw})

    _preproc_ifdef = _preproc_elif = _preproc_if

    def _case_statement(self, node: tree_sitter.Node) -> str:
        return self._children(node, {"value": self._raw})

    def _initializer_list(self, node: tree_sitter.Node) -> str:
        return self._raw(node) if self._raw(node) == "{0}" else self._children(node)

    # ---- statements ----
    def _expression_statement(self, node: tree_sitter.Node) -> str:
        inner = node.children[0] if node.children else node
        if inner.type == "cast_expression":
            inner = inner.child_by_field_name("value") or inner
        if inner.type == "call_expression" and self._opaque(inner):
            return self._raw(node)
        if inner.type not in ("assignment_expression", "call_expression", "update_expression"):
            return self._children(node)
        number = self._add(node, "is left out")
        text = self._children(node)
        return text if number is None else f"{{\n/*@{number}*/ if (!GF_ON({number}))\n{{ {text} }} }}"

    def _if_statement(self, node: tree_sitter.Node) -> str:
        return self._children(node, {"condition": self._condition})

    def _conditional_expression(self, node: tree_sitter.Node) -> str:
        return "(" + self._children(node, {"condition": self._condition}) + ")"

    def _while_statement(self, node: tree_sitter.Node) -> str:
        return self._children(node, {"condition": self._condition, "update": self._update})

    _do_statement = _for_statement = _while_statement

    def _update(self, node: tree_sitter.Node) -> str:
        """A loop's step: backwards, it would only hang."""
        return self._raw(node)

    def _return_statement(self, node: tree_sitter.Node) -> str:
        return (
            self._children(node) if node.named_child_count != 1 else f"return {self._returned(node.named_children[0])};"
        )

    def _returned(self, node: tree_sitter.Node) -> str:
        if node.type not in ("call_expression", "identifier", "field_expression", "subscript_expression"):
            return self._node(node)
        if CONSTANT_NAME.fullmatch(self._raw(node)):
            return self._node(node)
        number = self._add(node, "is returned negated")
        text = self._node(node)
        if number is None:
            return text
        return (
            f"({{\n/*@{number}*/ __auto_type gf_v = ({text}\n);\n/*@{number}*/ "
            f"GF_ON({number}) ? (__typeof__(gf_v))!gf_v : gf_v;\n}})"
        )

    # ---- conditions ----
    def _condition(self, node: tree_sitter.Node) -> str:
        """A condition, or an operand of one: it is also made always true and always false."""
        if node.type == "parenthesized_expression":
            return "(" + self._condition(node.named_children[-1]) + ")"
        operator = node.child_by_field_name("operator")
        sign = self._raw(operator) if operator is not None else ""
        if sign in (*COMPARISONS, "&&", "||", "!") or node.type in ("true", "false", "number_literal"):
            return self._node(node)
        return self._forced(node, self._node)

    def _forced(self, node: tree_sitter.Node, way: Callable[[tree_sitter.Node], str]) -> str:
        numbers = [self._add(node, f"is always {word}") for word in self._words(node)]
        return self._value(node, f"!!({way(node)}\n)", list(zip(numbers, self._words(node).values(), strict=True)))

    def _words(self, node: tree_sitter.Node) -> dict[str, str]:
        """What a truth value is made: never true in a loop's condition, which would hang."""
        above = node.parent
        while above is not None and above.type in ("parenthesized_expression", "binary_expression", "unary_expression"):
            node, above = above, above.parent
        loop = above is not None and above.type in LOOPS and above.child_by_field_name("condition") == node
        return {"false": "0"} if loop else {"true": "1", "false": "0"}

    def _value(self, node: tree_sitter.Node, text: str, others: list[tuple[int | None, str]], before: str = "") -> str:
        """Text of a value and of the values it may become."""
        made = [(number, other) for number, other in others if number is not None]
        if not made:
            return f"({{ {before} {text}; }})" if before else f"({text})"
        marks = "".join(f"/*@{number}*/" for number, _ in made)
        tries = "".join(f"/*@{number}*/ GF_TRY({number}, gf_v, {other});\n" for number, other in made)
        return f"({{ {before}\n{marks} __auto_type gf_v = {text};\n{tries}gf_v; }})"

    def _unary_expression(self, node: tree_sitter.Node) -> str:
        operator, argument = node.children[0], node.child_by_field_name("argument")
        assert argument is not None
        sign = self._raw(operator)
        if sign == "!":
            return self._forced(node, self._children)
        if sign not in ("-", "~") or self._constant(argument):
            return self._children(node)
        number = self._add(node, f"loses its {sign}")
        return self._value(node, f"{sign}gf_a", [(number, "gf_a")], f"__auto_type gf_a = ({self._node(argument)}\n);")

    def _sides(self, node: tree_sitter.Node) -> tuple[tree_sitter.Node, str, tree_sitter.Node]:
        left, operator, right = (node.child_by_field_name(name) for name in ("left", "operator", "right"))
        if left is None or operator is None or right is None:
            raise ValueError(f"{self.file}:{node.start_point[0] + 1}: {self._raw(node)} lacks a side")
        return left, self._raw(operator), right

    def _binary_expression(self, node: tree_sitter.Node) -> str:
        left, sign, right = self._sides(node)
        if sign in ("&&", "||"):
            number = self._add(node, f"with {'||' if sign == '&&' else '&&'}")
            a, b = self._condition(left), self._condition(right)
            if number is None:
                return f"({a} {sign} {b})"
            asked = f"GF_ON({number})" if sign == "&&" else f"!GF_ON({number})"
            return f"({{ int gf_a = !!({a}\n);\n/*@{number}*/ gf_a != {asked} ? !!({b}\n) : gf_a; }})"
        if sign in COMPARISONS:
            return self._comparison(node, left, sign, right)
        if self._constant(node) or sign not in OTHER:
            return self._children(node)
        other = OTHER[sign]
        number = self._add(node, f"with {other} for {sign}")
        alternative = f"gf_a {other} gf_b"
        if other in "/%":
            alternative = f"(gf_b != 0 ? {alternative} : 0)"
        return self._value(node, f"gf_a {sign} gf_b", [(number, alternative)], self._operands(left, right, number))

    def _operands(self, left: tree_sitter.Node, right: tree_sitter.Node, *numbers: int | None) -> str:
        marks = "".join(f"/*@{number}*/" for number in numbers if number is not None)
        return "".join(
            f"\n{marks} __auto_type {name} = ("
            + (self._raw(node) if self._constant(node) else self._node(node))
            + "\n);"
            for name, node in (("gf_a", left), ("gf_b", right))
        )

    def _comparison(self, node: tree_sitter.Node, left: tree_sitter.Node, sign: str, right: tree_sitter.Node) -> str:
        others: list[tuple[int | None, str]] = []
        kinds: list[int | None] = []
        for word, value in self._words(node).items():
            others.append((self._add(node, f"is always {word}"), value))
        if sign in BOUNDARY:
            constant = "gf_b" if self._constant(right) else "gf_a" if self._constant(left) else ""
            zero = constant and self._is_zero(right if constant == "gf_b" else left)
            real = None if zero else False
            if not self._picks_an_operand(node, left, right):
                others.append(
                    (self._add(node, f"with {BOUNDARY[sign]} for {sign}", real), f"gf_a {BOUNDARY[sign]} gf_b")
                )
                kinds += [others[-1][0]] if real is not None else []
            if constant:
                step = FARTHER[sign if constant == "gf_b" else MIRRORED[sign]]
                changes = [(f"with its constant {step} 1", False, f"({constant} {step} 1)")]
                if not zero:
                    changes += [(f"with its constant times {f}", True, f"({constant} * {f}f)") for f in ("1.1", "0.9")]
                for change, kind, value in changes:
                    a, b = (value, "gf_b") if constant == "gf_a" else ("gf_a", value)
                    others.append((self._add(node, change, kind), f"{a} {sign} {b}"))
                    kinds.append(others[-1][0])
        before = self._operands(left, right, *(number for number, _ in others))
        before += "".join(f"\n/*@{n}*/ GF_KIND({n}, gf_a + gf_b)" for n in kinds if n is not None)
        return self._value(node, f"gf_a {sign} gf_b", others, before)

    def _picks_an_operand(self, node: tree_sitter.Node, left: tree_sitter.Node, right: tree_sitter.Node) -> bool:
        """Whether a comparison chooses the larger or the smaller of what it compares: both are one at its boundary."""
        above = node.parent
        if above is None or above.type != "conditional_expression":
            return False
        branches = [above.child_by_field_name(name) for name in ("consequence", "alternative")]
        return {self._bare(branch) for branch in branches if branch} == {self._bare(left), self._bare(right)}

    def _bare(self, node: tree_sitter.Node) -> str:
        """Text of an expression without casts and parentheses around it."""
        while node.type in ("cast_expression", "parenthesized_expression"):
            node = node.named_children[-1]
        return self._raw(node)

    # ---- values ----
    def _opaque(self, call: tree_sitter.Node) -> bool:
        """Whether a call may be one of a macro, whose text must stay, or an assertion of the compiler."""
        function = call.child_by_field_name("function")
        name = self._raw(function) if function is not None else ""
        return name.lower() in ("_static_assert", "static_assert") or bool(CONSTANT_NAME.fullmatch(name))

    def _call_expression(self, node: tree_sitter.Node) -> str:
        return self._raw(node) if self._opaque(node) else self._children(node, {"function": self._raw})

    def _assignment_expression(self, node: tree_sitter.Node) -> str:
        left, sign, right = self._sides(node)
        above = node.parent
        if sign[:-1] not in OTHER or (above is not None and above.type == "for_statement"):
            return self._children(node)
        other = OTHER[sign[:-1]] + "="
        number = self._add(node, f"with {other} for {sign}")
        if number is None:
            return self._children(node)
        mark = f"/*@{number}*/"
        safe = "gf_e != 0 && " if other in ("/=", "%=") else ""
        before = (
            f"{mark} __auto_type gf_e = ({self._node(right)}\n);\n{mark} __auto_type gf_p = &({self._node(left)}\n);"
        )
        return f"({{\n{before}\n{mark} {safe}GF_ON({number}) ? (*gf_p {other} gf_e) : (*gf_p {sign} gf_e);\n}})"

    def _update_expression(self, node: tree_sitter.Node) -> str:
        above = node.parent
        if above is not None and above.type == "for_statement":
            return self._raw(node)
        number = self._add(node, "goes the other way")
        text = self._children(node)
        other = text.replace("++", "\0").replace("--", "++").replace("\0", "--")
        return text if number is None else f"(\n/*@{number}*/ GF_ON({number}) ? {other} : {text}\n)"

    def _constant(self, node: tree_sitter.Node) -> bool:
        """Whether an expression is made of literals and of names in capitals alone."""
        if node.type == "number_literal":
            return True
        if node.type == "identifier":
            return bool(CONSTANT_NAME.fullmatch(self._raw(node))) and self._raw(node) != "NULL"
        if node.type in ("parenthesized_expression", "binary_expression", "unary_expression"):
            return all(self._constant(child) for child in node.named_children)
        value = node.child_by_field_name("value")
        return node.type == "cast_expression" and value is not None and self._constant(value)

    def _is_zero(self, node: tree_sitter.Node) -> bool:
        return node.type == "number_literal" and not self._raw(node).rstrip("uUlLfF").strip("0.")

    def _number_literal(self, node: tree_sitter.Node) -> str:
        text = self._raw(node)
        real = "." in text or ("e" in text.lower() and not text.lower().startswith("0x"))
        number = self._add(node, "is more", shown=self._around(node))
        more = f"{text} * 1.1f" if real and not self._is_zero(node) else f"{text} + 1"
        return text if number is None else f"(\n/*@{number}*/ GF_ON({number}) ? {more} : {text}\n)"

    def _around(self, node: tree_sitter.Node) -> str:
        """A constant with what it stands in, without which nobody could tell which one is meant."""
        above = node.parent
        return f"{self._raw(node)}` in `{shortened(self._raw(above), 60)}" if above is not None else self._raw(node)

    def _true(self, node: tree_sitter.Node) -> str:
        number = self._add(node, f"is {'false' if node.type == 'true' else 'true'}", shown=self._around(node))
        return self._raw(node) if number is None else f"(\n/*@{number}*/ GF_ON({number}) != {self._raw(node)}\n)"

    _false = _true

    def _identifier(self, node: tree_sitter.Node) -> str:
        text = self._raw(node)
        if not CONSTANT_NAME.fullmatch(text) or text == "NULL":
            return text
        number = self._add(node, "is more", shown=self._around(node))
        return text if number is None else f"(\n/*@{number}*/ GF_ON({number}) ? GF_MORE({text}) : ({text})\n)"

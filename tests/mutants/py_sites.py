"""Rewrites Python modules as they are imported, so that one import holds all mutants: see `py_runtime`.

Only what functions compute is changed: no annotation, decorator, default, docstring or text, and nothing at the level
of a module or class; a constant of a module is changed where it is compared.
"""

from __future__ import annotations

import ast
import importlib.machinery
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from tests.mutants.mutant import Mutant, shortened
from tests.mutants.py_runtime import BOUNDARY, OTHER

CONSTANT_NAME = re.compile(r"_?[A-Z][A-Z0-9_]+")
BINARY: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.FloorDiv: "//",
    ast.Mod: "%",
    ast.Pow: "**",
    ast.BitAnd: "&",
    ast.BitOr: "|",
}
COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}
OPERATORS = {sign: operator for operator, sign in BINARY.items()}
RUNTIME = "_gf"


class Instrumented(ast.NodeTransformer):
    """One module, rewritten: `tree` is what to compile and `mutants` what it holds."""

    def __init__(self, file: str, source: str, first: int = 1):
        self.file, self.mutants = file, []
        self._next, self._functions = first, list[str]()
        self._loops, self._expressions = set[int](), list[str]()
        self.tree = self.visit(ast.parse(source, file))
        after = next((i for i, s in enumerate(self.tree.body) if not _stays_in_front(s)), len(self.tree.body))
        self.tree.body[after:after] = ast.parse(f"from tests.mutants import py_runtime as {RUNTIME}").body
        ast.fix_missing_locations(self.tree)

    # ---- mutants ----
    def _add(self, node: ast.AST, change: str, shown: str = "") -> int:
        number, self._next = self._next, self._next + 1
        what = f"`{shortened(shown or ast.unparse(node))}` {change}"
        line = getattr(node, "lineno", 0)
        self.mutants.append(Mutant(number, self.file, ".".join(self._functions), line, what))
        return number

    def _call(self, at: ast.expr, name: str, *arguments: Any) -> ast.expr:
        """A call of the runtime; what is no node becomes a constant."""
        given = [a if isinstance(a, ast.AST) else ast.parse(repr(a), mode="eval").body for a in arguments]
        function = ast.Attribute(ast.Name(RUNTIME, ast.Load()), name, ast.Load())
        return ast.copy_location(ast.Call(function, given, []), at)  # type: ignore[arg-type]

    # ---- where nothing is changed ----
    def visit(self, node: ast.AST) -> Any:
        """Rewrite a node of a function; elsewhere look for functions alone."""
        if not isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module) and not self._functions:
            return node
        if not isinstance(node, ast.expr):
            return super().visit(node)
        self._expressions.append(ast.unparse(node))
        made = super().visit(node)
        self._expressions.pop()
        return made

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self._functions.append(node.name)
        node.body = self._body(node.body)
        self._functions.pop()
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        if self._functions:
            return node
        node.body = [self._method(child, node.name) for child in node.body]
        return node

    def _method(self, node: ast.stmt, owner: str) -> ast.stmt:
        if not isinstance(node, ast.FunctionDef):
            return node
        self._functions.append(f"{owner}.{node.name}")
        node.body = self._body(node.body)
        self._functions.pop()
        return node

    def _body(self, body: Sequence[ast.stmt]) -> list[ast.stmt]:
        made: list[ast.stmt] = []
        for statement in body:
            new = self.visit(statement)
            made += new if isinstance(new, list) else [new]
        return made

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        """``zip(..., strict=True)`` only asserts."""
        return node if node.arg == "strict" else self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return node

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return node

    def visit_Assert(self, node: ast.Assert) -> ast.AST:
        return node

    def visit_Match(self, node: ast.Match) -> ast.AST:
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        node.body = self.visit(node.body)
        return node

    # ---- statements ----
    def _left_out(self, node: ast.stmt, made: ast.stmt, shown: str) -> ast.stmt:
        number = self._add(node, "is left out", shown)
        test = ast.UnaryOp(ast.Not(), self._call(ast.Constant(0, lineno=node.lineno, col_offset=0), "on", number))
        return ast.copy_location(ast.If(test, [made], []), node)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        if not isinstance(node.value, ast.Call):
            return node
        shown = ast.unparse(node)
        node.value = self.visit(node.value)
        return self._left_out(node, node, shown)

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        shown = ast.unparse(node)
        node.value = self.visit(node.value)
        stored = all(isinstance(target, ast.Attribute | ast.Subscript) for target in node.targets)
        return self._left_out(node, node, shown) if stored else node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        shown = ast.unparse(node)
        sign = BINARY.get(type(node.op))
        node.value = self.visit(node.value)
        if sign is None:
            return node
        number = self._add(node, f"with {OTHER[sign]}= for {sign}=", shown)
        other = ast.copy_location(ast.AugAssign(node.target, OPERATORS[OTHER[sign]](), node.value), node)
        test = self._call(node.value, "on", number)
        return self._left_out(node, ast.copy_location(ast.If(test, [other], [node]), node), shown)

    def visit_If(self, node: ast.If) -> ast.AST:
        node.test = self._condition(node.test)
        node.body, node.orelse = self._body(node.body), self._body(node.orelse)
        return node

    def visit_While(self, node: ast.While) -> ast.AST:
        if not isinstance(node.test, ast.Constant):
            self._loops.update(id(part) for part in ast.walk(node.test))
            node.test = self._condition(node.test)
        node.body, node.orelse = self._body(node.body), self._body(node.orelse)
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        node.test = self._condition(node.test)
        node.body, node.orelse = self.visit(node.body), self.visit(node.orelse)
        return node

    # ---- conditions ----
    def _forced(self, node: ast.expr) -> tuple[int, int]:
        """Numbers of the changes to true and to false; in a loop's condition true would hang."""
        true = 0 if id(node) in self._loops else self._add(node, "is always true")
        return true, self._add(node, "is always false")

    def _condition(self, node: ast.expr) -> ast.expr:
        if isinstance(node, ast.BoolOp):
            return self._junction(node, self._condition)
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARISONS:
            return self.visit(node)
        numbers = self._forced(node)
        return self._call(node, "truth", numbers, self.visit(node))

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        """Outside of conditions the value of an operand may be meant, not only its truth."""
        return self._junction(node, self.visit)

    def _junction(self, node: ast.BoolOp, way: Callable[[ast.expr], Any]) -> ast.expr:
        both = isinstance(node.op, ast.And)
        number = self._add(node, f"with {'or' if both else 'and'}")
        node.values = [way(value) for value in node.values]
        other = ast.copy_location(ast.BoolOp(ast.Or() if both else ast.And(), node.values), node)
        return ast.copy_location(ast.IfExp(self._call(node, "on", number), other, node), node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        sign = COMPARISONS.get(type(node.ops[0])) if len(node.ops) == 1 else None
        if sign is None:
            return self.generic_visit(node)
        left, right = node.left, node.comparators[0]
        constant = "right" if _is_constant(right) else "left" if _is_constant(left) else ""
        zero = bool(constant) and ast.unparse(right if constant == "right" else left) in ("0", "0.0")
        numbers = [*self._forced(node), 0, 0, 0, 0]
        if sign in BOUNDARY:
            numbers[2] = self._add(node, f"with {BOUNDARY[sign]} for {sign}")
            if constant:
                numbers[3] = self._add(node, "with its constant one further")
                if not zero:
                    numbers[4] = self._add(node, "with its constant times 1.1")
                    numbers[5] = self._add(node, "with its constant times 0.9")
        a, b = (side if _is_constant(side) else self.visit(side) for side in (left, right))
        return self._call(node, "compare", tuple(numbers), sign, a, b, constant, zero)

    # ---- values ----
    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        sign = BINARY.get(type(node.op))
        if sign is None or isinstance(node.left, ast.JoinedStr) or _is_text(node.left):
            return self.generic_visit(node)
        number = self._add(node, f"with {OTHER[sign]} for {sign}")
        return self._call(node, "binary", number, sign, self.visit(node.left), self.visit(node.right))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        if not isinstance(node.op, ast.USub) or isinstance(node.operand, ast.Constant):
            return self.generic_visit(node) if not isinstance(node.operand, ast.Constant) else node
        number = self._add(node, "loses its -")
        return self._call(node, "negated", number, self.visit(node.operand))

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if not isinstance(node.value, bool | int | float):
            return node
        around = shortened(self._expressions[-2], 60) if len(self._expressions) > 1 else ""
        shown = f"{node.value}` in `{around}" if around else repr(node.value)
        number = self._add(node, "is more" if not isinstance(node.value, bool) else f"is {not node.value}", shown)
        return self._call(node, "constant", number, node.value)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _is_constant(node: ast.expr) -> bool:
    """Whether an expression is made of numbers and of names in capitals alone."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.Name | ast.Attribute):
        return bool(CONSTANT_NAME.fullmatch(node.id if isinstance(node, ast.Name) else node.attr))
    if isinstance(node, ast.BinOp):
        return _is_constant(node.left) and _is_constant(node.right)
    return isinstance(node, ast.UnaryOp) and _is_constant(node.operand)


def _stays_in_front(statement: ast.stmt) -> bool:
    future = isinstance(statement, ast.ImportFrom) and statement.module == "__future__"
    return future or (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant))


class _Loader(importlib.machinery.SourceFileLoader):
    """Loads a module from its rewritten tree."""

    def __init__(self, name: str, path: str, tree: ast.Module):
        super().__init__(name, path)
        self._tree = tree

    def get_code(self, fullname: str) -> CodeType:
        return compile(self._tree, self.path, "exec")


class Finder(importlib.machinery.PathFinder):
    """Puts rewritten modules in the place of those of the given files; it stands first in ``sys.meta_path``."""

    def __init__(self, modules: dict[Path, Instrumented], package: str = "goldfield."):
        self._modules, self._package = modules, package

    def find_spec(  # type: ignore[override]
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return where a module is, for those that are rewritten."""
        if not fullname.startswith(self._package):
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
        made = self._modules.get(Path(spec.origin)) if spec is not None and spec.origin else None
        if spec is None or made is None:
            return None
        spec.loader = _Loader(fullname, str(spec.origin), made.tree)
        return spec


def install(modules: dict[Path, Instrumented]) -> None:
    """Have later imports of these files give the rewritten modules.

    Raises
    ------
    RuntimeError
        If one of the modules was imported before.
    """
    loaded = {Path(m.__file__) for m in list(sys.modules.values()) if getattr(m, "__file__", None)}
    early = sorted(str(path) for path in modules if path in loaded)
    if early:
        raise RuntimeError(f"these modules were imported before they were rewritten: {', '.join(early)}")
    sys.meta_path.insert(0, Finder(modules))  # type: ignore[arg-type]

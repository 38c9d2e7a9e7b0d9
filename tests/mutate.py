"""Changes one expression or statement of a named function, found through its syntax tree.

What is sought is a pattern: Python source in which a name that is local to the function stands for
any local of it (the same one throughout), and `__` (`__a`, `__b`) for any
expression. Formatting, comments, renamed
locals and functions moved within their package make no difference. C is compared token by
token.
"""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Iterator
from pathlib import Path

Function = ast.FunctionDef | ast.AsyncFunctionDef
_ANY = "__"


class Gone(LookupError):
    """What is to be changed is not there, or not there once."""


def mutated(root: Path, where: str, right: str, wrong: str) -> tuple[Path, str]:
    """The file that holds the place, and its source with `right` replaced by `wrong`.

    Args:
        root: the package's folder.
        where: "package name": a package or module below the root, dotted, and the function
            (`f`, `Class.f`) or constant in it or below it; or a folder and "C".
        right: a pattern that matches once there.
        wrong: what takes its place, an expression or statements; names and `__` are what they were
            matched to. "pass" drops a statement.

    Raises:
        Gone: says which function, or which pattern in it.
    """
    package, name = where.split(" ")
    if name == "C":
        return _in_c(root.joinpath(*package.split(".")), right, wrong)
    file, module, definition = _definition(root, package, name)
    new = ast.parse(wrong).body
    expression = len(new) == 1 and isinstance(new[0], ast.Expr)
    pattern = _parsed(right, expression)
    own = _locals(definition)
    found = [
        (node, names)
        for node in ast.walk(definition)
        if isinstance(node, ast.expr | ast.stmt) and _matches(pattern, node, own, names := {})
    ]
    if len(found) != 1:
        raise Gone(f"{where} in {file.relative_to(root)} has {right!r} {len(found)} times")
    node, names = found[0]
    fresh = [_filled(one, names) for one in ([_parsed(wrong, True)] if expression else new)]
    return file, ast.unparse(_Swap(node, fresh).visit(module))


def _definition(root: Path, package: str, name: str) -> tuple[Path, ast.Module, ast.AST]:
    """The only definition of a name in a module or package; else the only one beside it."""
    place = root.joinpath(*package.split("."))
    for folder in (place, place.parent):
        files = [file] if (file := folder.with_suffix(".py")).is_file() else folder.rglob("*.py")
        found = [
            (file, module, node)
            for file in sorted(files)
            if name.split(".")[-1] in (text := file.read_text())
            for module in [ast.parse(text)]
            for qualified, node in _definitions(module)
            if qualified == name
        ]
        if len(found) == 1:
            return found[0]
        if found:
            raise Gone(f"{name} is defined {len(found)} times in {package}")
    raise Gone(f"{name} has gone from {package}")


def _definitions(tree: ast.AST, outer: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Functions and constants by their qualified names."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, Function):
            yield outer + node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from _definitions(node, f"{outer}{node.name}.")
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                if isinstance(target, ast.Name):
                    yield outer + target.id, node


def _locals(definition: ast.AST) -> set[str]:
    """Names that are a function's own."""
    names = {n.arg for n in ast.walk(definition) if isinstance(n, ast.arg)}
    if isinstance(definition, Function):
        stored = (n for n in ast.walk(definition) if isinstance(n, ast.Name))
        names |= {n.id for n in stored if isinstance(n.ctx, ast.Store)}
    return names - {"self", "cls"}


def _parsed(text: str, expression: bool) -> ast.AST:
    """An expression or a statement."""
    return ast.parse(text, mode="eval").body if expression else ast.parse(text).body[0]


def _matches(pattern: object, node: object, own: set[str], names: dict[str, ast.AST]) -> bool:
    """Whether a node is what a pattern says; `names` takes what its names stand for."""
    if isinstance(pattern, ast.Name) and isinstance(node, ast.expr):
        if pattern.id.startswith(_ANY) or (isinstance(node, ast.Name) and node.id in own):
            known = names.setdefault(pattern.id, node)
            return ast.dump(known) == ast.dump(node) or _id(known) == _id(node) != ""
        return pattern.id == _id(node)
    if isinstance(pattern, ast.arg) and isinstance(node, ast.arg):
        return True
    if isinstance(pattern, ast.AST):
        return type(pattern) is type(node) and all(
            _matches(getattr(pattern, field), getattr(node, field), own, names)
            for field in pattern._fields
            if field not in ("ctx", "kind", "type_comment")
        )
    if isinstance(pattern, list):
        return (
            isinstance(node, list)
            and len(pattern) == len(node)
            and all(_matches(a, b, own, names) for a, b in zip(pattern, node, strict=True))
        )
    return type(pattern) is type(node) and pattern == node


def _id(node: ast.AST) -> str:
    return node.id if isinstance(node, ast.Name) else ""


def _filled(tree: ast.AST, names: dict[str, ast.AST]) -> ast.AST:
    """A replacement with what its names were matched to."""

    class Fill(ast.NodeTransformer):
        def visit_Name(self, node: ast.Name) -> ast.AST:
            return copy.deepcopy(names.get(node.id, node))

    return Fill().visit(tree)


class _Swap(ast.NodeTransformer):
    """Puts others in a node's place."""

    def __init__(self, old: ast.AST, new: list[ast.AST]) -> None:
        self._old, self._new = old, new

    def visit(self, node: ast.AST) -> ast.AST | list[ast.AST]:
        if node is not self._old:
            return self.generic_visit(node)
        return self._new[0] if len(self._new) == 1 else self._new


def _in_c(folder: Path, right: str, wrong: str) -> tuple[Path, str]:
    """The same in a folder's C, whatever space is between tokens."""
    tokens = re.findall(r"\w+|[^\w\s]", right)
    pattern = re.compile(r"\s*".join(map(re.escape, tokens)))
    texts = {file: file.read_text() for file in sorted(folder.glob("*.[ch]"))}
    found = [(file, match) for file in texts for match in pattern.finditer(texts[file])]
    if len(found) != 1:
        raise Gone(f"{folder.name} has {right!r} {len(found)} times in C")
    file, match = found[0]
    return file, texts[file][: match.start()] + wrong + texts[file][match.end() :]

"""A function is read on one screen: at most 60 lines, its signature and docstring counted."""

import ast
from pathlib import Path

import matcap

ROOMS = ("capture", "example", "field")
MOST = 60


def test_no_function_is_longer_than_a_screen():
    root = Path(matcap.__file__).parent
    files = sorted(file for room in ROOMS for file in (root / room).rglob("*.py"))
    assert len(files) > 60
    longer = [
        f"{file.relative_to(root)}: {node.name} has {length} lines"
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (length := (node.end_lineno or node.lineno) - node.lineno + 1) > MOST
    ]
    assert longer == []

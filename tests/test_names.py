"""One name, one thing: whoever reads a class's name knows which class is meant."""

import ast
from collections import Counter
from pathlib import Path

import matcap

FILES = sorted(Path(matcap.__file__).parent.rglob("*.py"))


def test_no_two_classes_share_a_name():
    trees = [ast.parse(file.read_text(encoding="utf-8")) for file in FILES]
    names = Counter(n.name for tree in trees for n in ast.walk(tree) if isinstance(n, ast.ClassDef))
    assert len(names) > 100
    assert [name for name, count in names.items() if count > 1] == []

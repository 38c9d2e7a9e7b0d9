"""One name, one thing: whoever reads the name of a class or an alias knows what is meant."""

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


def test_no_alias_is_another_thing_elsewhere():
    """Types have capitals; the same definition may stand in several files."""
    meant: dict[str, set[str]] = {}
    for file in FILES:
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                meant.setdefault(node.name, set()).add(f"class of {file.name}")
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id
                if name[0].isupper() and not name.isupper():
                    meant.setdefault(name, set()).add(ast.unparse(node.value))
    assert {name: sorted(found) for name, found in meant.items() if len(found) > 1} == {}

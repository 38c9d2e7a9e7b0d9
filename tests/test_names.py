"""One name, one thing: whoever reads the name of a class or an alias knows what is meant."""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Of the product and of the laboratory.
FILES = sorted(
    file
    for file in (*ROOT.glob("matcap/**/*.py"), *ROOT.glob("lab/*/**/*.py"))
    if "tests" not in file.parts[len(ROOT.parts) :]
)


@cache
def trees() -> dict[Path, ast.Module]:
    return {file: ast.parse(file.read_bytes()) for file in FILES}


def test_no_two_classes_share_a_name():
    nodes = (node for tree in trees().values() for node in ast.walk(tree))
    names = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    assert len(names) > 100 and [name for name, count in names.items() if count > 1] == []


def test_no_alias_is_another_thing_elsewhere():
    """Types have capitals; the same definition may stand in several files."""
    meant: dict[str, set[str]] = {}
    for file, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                meant.setdefault(node.name, set()).add(f"class of {file.name}")
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id
                if name[0].isupper() and not name.isupper():
                    meant.setdefault(name, set()).add(ast.unparse(node.value))
    assert {name: sorted(found) for name, found in meant.items() if len(found) > 1} == {}


# Words that stood for many things in this code. Names use the terms of graphics and vision.
WORDS = {
    "told",
    "found",
    "believed",
    "lend",
    "lent",
    "answering",
    "beside",
    "away",
    "apart",
    "held",
}
TERMS = ("held_out", "hand_held", "NotFound")  # of statistics, of photography, of Python


def identifiers(tree: ast.Module) -> set[str]:
    """Names of what a module defines, binds, reads, passes or takes by name."""
    names: set[str | None] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                names.add(name)
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                names.add(name)
            case ast.ClassDef(name=name) | ast.keyword(arg=name):
                names.add(name)
    return {name for name in names if name}


def words(name: str) -> set[str]:
    """Of snake_case and CamelCase, but for terms that hold one of the words."""
    for term in TERMS:
        name = re.sub(term, "", name, flags=re.IGNORECASE)
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)}


def test_names_are_of_the_fields_own_words():
    """A module, class, function, field, parameter or variable is named for what it is."""
    assert words("told_apart") & WORDS == {"told", "apart"} and not words("HELD_OUT") & WORDS
    seen = {file: {file.stem} | identifiers(tree) for file, tree in trees().items()}
    wrong = {
        f"{file.name}: {name}"
        for file, names in seen.items()
        for name in names
        if words(name) & WORDS or name.startswith(("shows_", "_shows_"))
    }
    assert wrong == set()

"""Files know each other one way: nobody imports, by whatever way round, who imports it."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import matcap

ROOT = Path(matcap.__file__).parent


def name_of(file: Path) -> str:
    """A module's, or a package's."""
    parts = file.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def imports(tree: ast.Module, known: set[str]) -> Iterator[str]:
    """Modules that a file imports when it runs, also inside its functions; not what types name."""
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.ImportFrom) and node.module in known:
            inside = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name if name in known else node.module for name in inside)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)


def test_no_files_go_in_circles() -> None:
    files = {name_of(file): file for file in ROOT.rglob("*.py")}
    known = set(files)
    graph = {
        name: set(imports(ast.parse(file.read_text(encoding="utf-8")), known)) - {name}
        for name, file in files.items()
    }
    assert sum(map(len, graph.values())) > 1000
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None

"""Files know each other one way: nobody imports, by whatever way round, who imports it.

`python tests/test_rooms.py` counts the arrows: which room names anything of which other, types too.
"""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

CLONE = Path(__file__).parents[1]
# The product's packages, and the laboratory's.
ROOTS = [CLONE / "matcap", *(root.parent for root in CLONE.glob("lab/matcap*/__init__.py"))]


def name_of(file: Path) -> str:
    """A module's, or a package's."""
    root = next(root for root in ROOTS if file.is_relative_to(root))
    parts = file.relative_to(root.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def imports(tree: ast.Module, known: set[str], *, types: bool = False) -> Iterator[str]:
    """Modules that a file imports when it runs, inside functions too; or also what types name."""
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if not types and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
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


def graph_of(*, types: bool = False) -> dict[str, set[str]]:
    """What each module imports."""
    files = {name_of(file): file for root in ROOTS for file in root.rglob("*.py")}
    known = set(files)

    def of(name: str) -> set[str]:
        tree = ast.parse(files[name].read_text(encoding="utf-8"))
        return set(imports(tree, known, types=types)) - {name}

    return {name: of(name) for name in files}


def test_no_files_go_in_circles() -> None:
    """Imports for types count, too."""
    graph = graph_of(types=True)
    assert sum(map(len, graph.values())) > 1000
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None


def room(name: str) -> str:
    """A package or file of the top level, the package itself, or the laboratory's."""
    top, _, inner = name.partition(".")
    return top if top != "matcap" else inner.split(".")[0] or "__init__"


if __name__ == "__main__":
    arrows = {
        (room(one), room(other))
        for one, others in graph_of(types=True).items()
        for other in others
        if room(one) != room(other)
    }
    print(len(arrows), "arrows")
    for one, other in sorted(arrows):
        print(one, "->", other)

"""References and generated pages are up to date."""

import ast
import importlib
import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
import typer.main
from guide import anchors
from make_reference import BY_HAND, FOLDER, written
from make_reference import PAGES as MAKE_REFERENCE_PAGES
from reference import commands, docstrings, exit_codes, formats, interface
from safetensors import safe_open

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.brdf.stated import SPECULAR_CHANNELS
from matcap.cli.main import command_line, main
from matcap.errors import ExitCode
from matcap.example.example import Example
from matcap.example.exemplar import CHANNELS, Exemplar
from matcap.field.material import LATENT, Latent
from matcap.files.settings import field_docs
from matcap.relight.foreign import names
from matcap.relight.scene import Camera, Film, Light, Surface
from matcap.space.freeze import Drawing
from matcap.space.tuned import TunedDecoder

# docs/reference: whole, right, and as new as the code it is written from.


@pytest.mark.parametrize("name", MAKE_REFERENCE_PAGES)
def test_pages_are_as_new_as_the_code(name):
    assert (FOLDER / name).read_text(encoding="utf-8") == written(name), (
        "write them again: python docs/tools/make_reference.py"
    )


def test_there_is_no_other_reference_page():
    assert {file.name for file in FOLDER.iterdir()} == {*MAKE_REFERENCE_PAGES, *BY_HAND}


def test_inputs_tell_every_kind_of_file_and_packing_that_is_read():
    page = (FOLDER / "inputs.md").read_text(encoding="utf-8").lower()
    for suffix in names.READ_SUFFIXES:
        assert {".tif": "tiff", ".jpg": "jpeg"}.get(suffix, suffix.removeprefix(".")) in page
    letters = re.compile("(ao|a|o|r|m){3}")
    for short in names.SHORT:
        assert letters.fullmatch(short) or short in page, short
    for kind in names.USED:
        assert kind in page or kind == "base", kind


def parsers(command, name="matcap"):
    """(name, parser) of every command, as typer makes them."""
    yield name, command
    for word, one in getattr(command, "commands", {}).items():
        yield from parsers(one, f"{name} {word}")


PARSERS = [
    (name, parser)
    for name, parser in parsers(typer.main.get_command(command_line()))
    if name == "matcap" or not hasattr(parser, "commands")
]


@pytest.mark.parametrize(("name", "parser"), PARSERS, ids=[name for name, _ in PARSERS])
def test_the_reference_has_every_option_of_every_command(name, parser):
    section = commands.page().split(f"\n## {name}\n")[1].split("\n## ")[0]
    for parameter in parser.params:
        if parameter.param_type_name == "option" and parameter.name not in (
            "help", "install_completion", "show_completion",
        ):  # fmt: skip
            for option in parameter.opts:
                assert f"`{option}`" in section


def test_the_reference_has_what_the_python_guide_imports():
    guide = (FOLDER.parent / "guide" / "python.md").read_text(encoding="utf-8")
    snippets = "\n".join(re.findall(r"```python\n(.*?)```", guide, re.DOTALL))
    imported = [node for node in ast.walk(ast.parse(snippets)) if isinstance(node, ast.ImportFrom)]
    assert imported
    for node in imported:
        assert {name.name for name in node.names} <= set(interface.MODULES[node.module])


def test_the_reference_explains_every_argument_and_field():
    # A row that ends without words has no docstring behind it.
    bare = re.findall(r"^\| `\w+` .*\|  \|$", interface.page(), re.MULTILINE)
    assert bare == []


def test_the_reference_has_every_exit_code():
    codes = re.findall(r"^\| (\d+) \| `\w+` \| \S", exit_codes.page(), re.MULTILINE)
    assert [int(code) for code in codes] == list(ExitCode)


def test_a_material_holds_what_the_reference_states(small, tmp_path):
    maps = small.maps(96, 96)
    channels, sure = (getattr(maps, name).numpy() for name in CHANNELS), np.ones((4, 96, 96), "f4")
    piece = Exemplar(*channels, confidence=sure, texel_size=maps.texel_size)
    example = Example.of(piece)
    drawn = replace(small.part(TunedDecoder), drawing=Drawing(Example.of(piece)))
    both = {"example": example, "decoder": drawn}
    latent = Latent(torch.zeros(LATENT), (), "0")
    replace(small, generators=both, latent=latent).save(tmp_path / "leather.matcap")
    with safe_open(tmp_path / "leather.matcap", framework="pt") as file:
        about, tensors = json.loads(file.metadata()["matcap"]), list(file.keys())
    assert set(about) == formats.keys("matcap.field.material", "Metadata")
    stated = formats.keys("matcap.field.material", "Tensors")
    result = [key.replace("*", r"[\w.]+") for key in stated]
    assert all(any(re.fullmatch(key, name) for key in result) for name in tensors)
    assert all(any(re.fullmatch(key, name) for name in tensors) for key in result)


def test_a_map_set_and_its_exports_hold_what_the_reference_states(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    maps, result = small.maps(32, 32), formats.keys("matcap.brdf.folder", "Keys")
    file = write_mapset(maps, "leather", MapSetInfo("leather"), png=True)
    assert set(json.loads(file.read_text())) == result - {SPECULAR_CHANNELS}
    gold = replace(maps, specular=maps.specular.expand(3, -1, -1))
    file = write_mapset(gold, "gold", MapSetInfo("gold"), png=True)
    assert set(json.loads(file.read_text())) == result
    found = set()
    for target in ("gltf", "blender", "unreal"):
        assert main(["export", "leather", "--to", target, "-q", "-o", target]) == 0
        found |= set(json.loads((tmp_path / target / f"leather_{target}.json").read_text()))
    assert found == formats.keys("matcap.export.targets", "Keys")


def test_a_self_contained_page_holds_what_the_reference_states(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small.save("leather.matcap")
    assert main(["view", "leather.matcap", "--html", "page.html", "--tile", "32", "-q"]) == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    (about,) = re.findall(r'<script[^>]*id="about"[^>]*>(.*?)</script>', page, re.DOTALL)
    assert set(json.loads(about)["tile"]) == formats.keys("matcap.view.document", "Tile")


def test_scenes_take_the_keys_of_the_reference():
    kinds = {Film, Camera, Surface, *get_args(Light)}
    for kind in kinds:
        assert {field.name for field in fields(kind)} == set(field_docs(kind))
    assert {kind for _, kind, _ in formats._TABLES} == kinds


class Told:
    """One line.

    More of it.

    Args:
        first, second: two that share their words.
        third: has ``code``: and a colon.

    Example:
        Told(1, 2, 3)

    The end.
    """


def test_docstrings_are_parsed():
    found = docstrings.read(Told)
    assert found.text == "One line.\n\nMore of it.\n\nThe end."
    assert found.entries("Args") == {
        "first": "two that share their words.",
        "second": "two that share their words.",
        "third": "has ``code``: and a colon.",
    }
    assert found.sections["Example"].strip() == "Told(1, 2, 3)"
    assert docstrings.cell("a ``|`` b\nc") == r"a `\|` b c"


# What comments, docstrings and pages refer to exists: pages, files, modules and papers.

ROOT = Path(__file__).parents[2]
FOLDERS = ("matcap", "lab", "tests", "docs", "examples")
# Changes tell of what was; weights' cards stand in the same folder as what they describe.
PAGES = sorted({*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("matcap/**/*.md")})
PAGES.remove(ROOT / "CHANGELOG.md")
MODULES = sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))
OTHERS = sorted(
    file
    for folder in FOLDERS
    for pattern in ("*.c", "*.h", "*.js", "*.toml")
    for file in (ROOT / folder).rglob(pattern)
)
FILES = [*PAGES, *MODULES, *OTHERS]

BIBLIOGRAPHY = ROOT / "docs" / "references.bib"
CITED = re.compile(r"\[([a-z]+\d{4}(?:[;,] [^][]+)?)\]")
KEY = re.compile(r"^[a-z]+\d{4}$")
# Heitz 2014; Lefebvre and Hoppe (2005, 2006); Henzler, Mitra and Ritschel (2020); He et al. 2016.
MENTIONED = re.compile(
    r"\b([A-Z][a-z]+)(?:(?:, [A-Z]\w+)* and [A-Z]\w+| et al\.)?,? "
    r"\(?((?:17|19|20)\d\d)\b(?!-\d\d)"
)
# Words before a year that are nobody's name.
NO_NAMES = {
    "January", "February", "March", "April", "May", "June", "July", "August", "September",
    "October", "November", "December", "Since", "Before", "Until", "In", "After", "By", "Of",
}  # fmt: skip

PATH = re.compile(
    r"(?<![\w/.*<>{}-])((?:[\w-]+/)*[\w-]+\.(?:py|c|h|js|toml|bib|md|csv))(#[\w-]+)?(?![\w/*])"
)
DOTTED = re.compile(r"(?<![\w/.\"'-])matcap(?:\.[A-Za-z_]\w*)+")
# Scripts that an export of NAME has.
EXPORTED = re.compile(r"(?:T_)?(?:NAME|leather)_\w+(?:/\w+)?\.py$")
# What docs/guide/extend.md has its reader make.
WALKED_THROUGH = {"matcap/relight/effects/fuzz.py"}
# Files that users have, and examples of names.
NOT_MODULES = {"matcap.toml", "matcap.a.b"}


@cache
def prose(file: Path) -> str:
    """A page's text; of a module its comments and docstrings."""
    text = file.read_text(encoding="utf-8")
    if file.suffix != ".py":
        return re.sub(r"https?://\S+", "", text)
    # Docstrings of modules, classes, functions and fields are all statements of one string.
    docstrings = [
        node.value.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ]
    comments = re.findall(r"(?:^|\s)#.*", text)  # and what looks so in strings; tokens take long
    return "\n".join([*docstrings, *comments])


@cache
def known_names() -> frozenset[str]:
    return frozenset(
        file.name for folder in FOLDERS for file in (ROOT / folder).rglob("*") if file.is_file()
    )


def found(path: str, file: Path) -> Path | None:
    """The file that a path means: from the root, from matcap/, or from near the file that says it.

    A name without folders stands for a file of this name beside it, or the only ones there are.
    """
    places = (ROOT, ROOT / "matcap", ROOT / "tests", *file.parents)
    for place in places:
        if place.is_relative_to(ROOT) and (place / path).is_file():
            return place / path
    return Path(path) if "/" not in path and path in known_names() else None


def dead_paths(file: Path) -> Iterator[str]:
    # Of other projects' and users' files only those in our folders can be told.
    for path, anchor in PATH.findall(prose(file)):
        ours = path.split("/")[0] in FOLDERS or path.endswith((".py", ".bib"))
        if not ours or EXPORTED.match(path) or path in WALKED_THROUGH:
            continue
        place = found(path, file)
        if place is None or (anchor and place.is_file() and anchor[1:] not in anchors(place)):
            yield path + anchor


def faults(check: Callable[[Path], Iterable[str]]) -> dict[str, list[str]]:
    """What a check finds, by file."""
    found = {str(file.relative_to(ROOT)): sorted(check(file)) for file in FILES}
    return {name: wrong for name, wrong in found.items() if wrong}


def test_named_files_and_pages_exist():
    assert faults(dead_paths) == {}


@cache
def public(module: Path) -> frozenset[str]:
    """Names that a module defines or imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute):
            names.add(node.id if isinstance(node, ast.Name) else node.attr)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names.update(alias.asname or alias.name for alias in node.names)
    return frozenset(names)


def exists(dotted: str) -> bool:
    """Whether a dotted name is a module, or a name in one."""
    place, parts = ROOT / "matcap", dotted.split(".")[1:]
    while parts and (place / parts[0]).is_dir():
        place, parts = place / parts[0], parts[1:]
    module = place / "__init__.py"
    if parts and (place / f"{parts[0]}.py").is_file():
        module, parts = place / f"{parts[0]}.py", parts[1:]
    if not parts:
        return True
    return parts[0] in public(module) or (
        module.parent == ROOT / "matcap" and hasattr(importlib.import_module("matcap"), parts[0])
    )


def dead_modules(file: Path) -> list[str]:
    named = set(DOTTED.findall(prose(file))) - NOT_MODULES
    return [name for name in named if not exists(name)]


def test_named_modules_exist():
    assert faults(dead_modules) == {}


@cache
def keys() -> frozenset[str]:
    entries = re.findall(r"^@\w+\{(\w+),", BIBLIOGRAPHY.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(entries) == len(set(entries)) > 50
    return frozenset(entries)


def cited(file: Path) -> set[str]:
    """Keys that a file cites: [heitz2014], [heitz2014, eq. 99], [gatys2015; liu2016]."""
    parts = ";".join(CITED.findall(prose(file))).split(";")
    return {key for part in parts if KEY.match(key := part.split(",")[0].strip())}


def mentioned(file: Path) -> set[str]:
    """Keys of papers that a file names in words: Heitz 2014."""
    text = re.sub(r"\s+", " ", prose(file))
    return {
        f"{name.lower()}{year}" for name, year in MENTIONED.findall(text) if name not in NO_NAMES
    }


def test_cited_papers_are_in_the_bibliography():
    assert faults(lambda file: (cited(file) | mentioned(file)) - keys()) == {}


def test_every_entry_of_the_bibliography_is_cited():
    used = set().union(*(cited(file) | mentioned(file) for file in FILES))
    assert sorted(keys() - used) == []


def test_a_key_is_surname_and_year():
    text = BIBLIOGRAPHY.read_text(encoding="utf-8")
    for entry in re.split(r"^@\w+\{", text, flags=re.MULTILINE)[1:]:
        key = entry.split(",")[0]
        surname = re.search(r"author = \{(\w+)", entry)[1].lower()
        year = re.search(r"year = \{(\d{4})\}", entry)[1]
        assert key == f"{surname}{year}"


def test_dead_references_are_found(tmp_path):
    """The checks themselves: a page that is wrong in every way."""
    page = tmp_path / "page.md"
    page.write_text("docs/gone.md matcap/gone.py matcap.gone.x [nobody1999] Nobody (1998)")
    assert list(dead_paths(page)) == ["docs/gone.md", "matcap/gone.py"]
    assert not exists("matcap.gone.x") and exists("matcap.flash.coarse.fit.fit_coarse")
    assert cited(page) == {"nobody1999"} and mentioned(page) == {"nobody1998"}

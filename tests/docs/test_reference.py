"""docs/reference: whole, right, and as new as the code it is written from."""

import ast
import json
import re
from dataclasses import fields, replace
from typing import get_args

import numpy as np
import pytest
import typer.main
from make_reference import BY_HAND, FOLDER, PAGES, written
from reference import commands, docstrings, exit_codes, formats, interface
from safetensors import safe_open

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.brdf.stated import SPECULAR_CHANNELS
from matcap.cli.main import app, main
from matcap.errors import ExitCode
from matcap.example.example import Example
from matcap.example.exemplar import CHANNELS, Exemplar
from matcap.files.settings import field_docs
from matcap.relight.foreign import names
from matcap.relight.scene import Camera, Film, Light, Surface
from matcap.space.drawing import Drawing
from matcap.space.tuned import TunedDecoder


@pytest.mark.parametrize("name", PAGES)
def test_pages_are_as_new_as_the_code(name):
    assert (FOLDER / name).read_text(encoding="utf-8") == written(name), (
        "write them again: python docs/tools/make_reference.py"
    )


def test_no_other_page_is_there():
    assert {file.name for file in FOLDER.iterdir()} == {*PAGES, *BY_HAND}


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
    for name, parser in parsers(typer.main.get_command(app))
    if name == "matcap" or not hasattr(parser, "commands")
]


@pytest.mark.parametrize(("name", "parser"), PARSERS, ids=[name for name, _ in PARSERS])
def test_every_option_of_every_command_is_there(name, parser):
    section = commands.page().split(f"\n## {name}\n")[1].split("\n## ")[0]
    for parameter in parser.params:
        if parameter.param_type_name == "option" and parameter.name not in (
            "help", "install_completion", "show_completion",
        ):  # fmt: skip
            for option in parameter.opts:
                assert f"`{option}`" in section


def test_what_the_python_guide_imports_is_there():
    guide = (FOLDER.parent / "guide" / "python.md").read_text(encoding="utf-8")
    snippets = "\n".join(re.findall(r"```python\n(.*?)```", guide, re.DOTALL))
    imported = [node for node in ast.walk(ast.parse(snippets)) if isinstance(node, ast.ImportFrom)]
    assert imported
    for node in imported:
        assert {name.name for name in node.names} <= set(interface.MODULES[node.module])


def test_every_argument_and_field_is_explained():
    # A row that ends without words has no docstring behind it.
    bare = re.findall(r"^\| `\w+` .*\|  \|$", interface.page(), re.MULTILINE)
    assert bare == []


def test_every_exit_code_is_there():
    codes = re.findall(r"^\| (\d+) \| `\w+` \| \S", exit_codes.page(), re.MULTILINE)
    assert [int(code) for code in codes] == list(ExitCode)


def test_a_material_holds_what_is_told(small, tmp_path):
    maps = small.maps(96, 96)
    piece = Exemplar(
        *(getattr(maps, name).numpy() for name in CHANNELS),
        confidence=np.ones((4, 96, 96), np.float32),
        texel_size=maps.texel_size,
    )
    example = Example.of(piece)
    drawn = replace(small.part(TunedDecoder), drawing=Drawing(example))
    both = {"example": example, "decoder": drawn}
    replace(small, generators=both).save(tmp_path / "leather.matcap")
    with safe_open(tmp_path / "leather.matcap", framework="pt") as file:
        about, tensors = json.loads(file.metadata()["matcap"]), list(file.keys())
    assert set(about) == formats.keys("matcap.field.material", "Metadata")
    result = [
        key.replace("*", r"[\w.]+") for key in formats.keys("matcap.field.material", "Tensors")
    ]
    assert all(any(re.fullmatch(key, name) for key in result) for name in tensors)
    assert all(any(re.fullmatch(key, name) for name in tensors) for key in result)


def test_a_map_set_and_its_exports_hold_what_is_told(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    maps, result = small.maps(32, 32), formats.keys("matcap.brdf.folder", "Keys")
    file = write_mapset(maps, "leather", MapSetInfo("leather"), png=True)
    assert set(json.loads(file.read_text())) == result - {SPECULAR_CHANNELS}
    gold = replace(maps, specular=maps.specular.expand(3, -1, -1))
    assert (
        set(json.loads(write_mapset(gold, "gold", MapSetInfo("gold"), png=True).read_text()))
        == result
    )
    found = set()
    for target in ("gltf", "blender", "unreal"):
        assert main(["export", "leather", "--to", target, "-q", "-o", target]) == 0
        found |= set(json.loads((tmp_path / target / f"leather_{target}.json").read_text()))
    assert found == formats.keys("matcap.export.targets", "Keys")


def test_a_page_for_sending_holds_what_is_told(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small.save("leather.matcap")
    assert main(["view", "leather.matcap", "--html", "page.html", "--tile", "32", "-q"]) == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    (about,) = re.findall(r'<script[^>]*id="about"[^>]*>(.*?)</script>', page, re.DOTALL)
    assert set(json.loads(about)["tile"]) == formats.keys("matcap.view.enclosed", "Tile")


def test_scenes_take_the_keys_that_are_told():
    kinds = {Film, Camera, Surface, *get_args(Light)}
    for kind in kinds:
        assert {field.name for field in fields(kind)} == set(field_docs(kind))
    assert {kind for _, kind, _ in formats._TABLES} == kinds


class Told:
    """One line.

    More of it.

    Args:
        first, second: two that
            share their words.
        third: has ``code``: and a colon.

    Example:
        Told(1, 2, 3)

    The end.
    """


def test_docstrings_are_taken_apart():
    found = docstrings.read(Told)
    assert found.text == "One line.\n\nMore of it.\n\nThe end."
    assert found.entries("Args") == {
        "first": "two that share their words.",
        "second": "two that share their words.",
        "third": "has ``code``: and a colon.",
    }
    assert found.sections["Example"].strip() == "Told(1, 2, 3)"
    assert docstrings.cell("a ``|`` b\nc") == r"a `\|` b c"

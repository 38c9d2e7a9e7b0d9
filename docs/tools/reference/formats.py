"""Files that matcap writes and reads, from the modules and the dataclasses that own them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import MISSING, fields
from importlib import import_module
from importlib.resources import files
from types import ModuleType

from matcap.batch.samples import SETTINGS
from matcap.brdf.folder import MEANINGS, PNG_ENCODINGS
from matcap.brdf.maps import CHANNELS
from matcap.files.settings import field_docs
from matcap.relight import scene
from reference.docstrings import read, table

_HEAD = """\
# File formats

Files appear under their names only when all of them are whole, and on the disk; a failure leaves
what was there before. Materials and map sets carry a version of their own, and a file of another
version is refused, not misread.

## What the numbers mean

Plane z = 0, x right, y up, z towards the camera. The photograph's long side spans x in [-1, 1], so
the *plane unit* is half that side.

Reflectance is diffuse / pi + D G F / (4 (n.l)(n.v)) with GGX, height-correlated Smith and Schlick.
Normals are derived from the height and point +Y up (OpenGL) unless `--normal dx` was asked for.
"""
_SCENE = """\
One table of each kind, and any number of `[[light]]`; all may be left out, and so may every key
that has a default. An unknown key is an error that names the nearest right one. Lengths are plane
units, angles degrees, colours linear Rec.709. Files are relative to the scene file: `.exr` or
`.hdr` for environment maps. Examples: `examples/scenes`.
"""
_REPORT = """\
Input, settings, errors, verdict and versions of a capture, as `matcap/capture/report.schema.json`
says, a JSON Schema. Angles in degrees, times in seconds, lengths in plane units.
"""
_SETTINGS = """\
In the folder of photographs or beside it. Keys are the names of the options of
[matcap batch](commands.md#matcap-batch), with `_` or `-`. Options override the file. Paths are
relative to the file.
"""
_TABLES = (
    ("[film]", scene.Film, None),
    ("[camera]", scene.Camera, None),
    ("[surface]", scene.Surface, None),
    ("[[light]]", scene.PointLight, "point"),
    ("[[light]]", scene.DirectionalLight, "directional"),
    ("[[light]]", scene.SphereLight, "sphere"),
    ("[[light]]", scene.RectangleLight, "rectangle"),
    ("[[light]]", scene.EnvironmentLight, "environment"),
)
# Heading, the module that owns the format, and the sections of its docstring that list keys.
_OWNED = (
    ("Material: `.matcap`", "matcap.field.material", ("Tensors", "Metadata")),
    ("Map set: a folder", "matcap.brdf.folder", ("Keys",)),
    ("Export: `NAME_TARGET.json`", "matcap.export.targets", ("Keys",)),
    ("Page for sending: `.html`", "matcap.view.document", ("Tile",)),
)


def page() -> str:
    """The page, in Markdown."""
    lines = [_HEAD, *_maps()]
    for heading, module, sections in _OWNED:
        lines += [f"## {heading}", "", *_owned(import_module(module), sections)]
    lines += ["## Report: `report.json`", "", _REPORT]
    lines += table(["keys", ""], ([f"`{key}`", says] for key, says in report_keys().items()))
    lines += ["## Scene: TOML", "", _SCENE, *_scene(), "## Settings: `matcap.toml`", "", _SETTINGS]
    lines += _settings()
    return "\n".join(lines)


def keys(module: str, section: str) -> set[str]:
    """The keys that a module says its files have."""
    return set(read(import_module(module)).entries(section))


def report_keys() -> dict[str, str]:
    """The keys of report.json and what they are, as its JSON Schema says."""
    schema = json.loads(files("matcap.capture").joinpath("report.schema.json").read_text())
    return {key: says["description"] for key, says in schema["properties"].items()}


def _maps() -> list[str]:
    """What each map of a set holds, and how it is stored."""
    rows = []
    for kind, meaning in MEANINGS.items():
        depth = "32-bit float" if kind == "height" else "half float"
        channels = str(CHANNELS.get(kind, 3))
        rows.append([kind, channels, meaning, depth, PNG_ENCODINGS[kind]])
    return table(["map", "channels", "meaning", "EXR", "PNG, 16 bits"], rows)


def _owned(module: ModuleType, sections: tuple[str, ...]) -> Iterator[str]:
    found = read(module)
    # The first line says what the module is; what follows, if anything, what the file is.
    first, _, rest = found.text.partition("\n")
    yield from (rest.strip() or first, "")
    for section in sections:
        entries = found.entries(section)
        yield from table([section.lower(), ""], ([f"`{k}`", v] for k, v in entries.items()))


def _scene() -> Iterator[str]:
    for heading, kind, name in _TABLES:
        found = read(kind)
        documented = found.entries("Attributes") | field_docs(kind)
        title = f'`{heading}` with `type = "{name}"`' if name else f"`{heading}`"
        yield from (f"### {title}", "", found.text, "")
        rows = []
        for one in fields(kind):
            default = "needed" if one.default is MISSING else _toml(one.default)
            rows.append([f"`{one.name}`", _kind(str(one.type)), default, documented[one.name]])
        yield from table(["key", "", "default", "what"], rows)


def _settings() -> list[str]:
    """Keys of a batch's settings file."""
    return table(
        ["key", "default", "what"],
        ([f"`{name}`", _toml(one.default), one.help] for name, one in SETTINGS.items()),
    )


def _kind(annotation: str) -> str:
    """What a key takes, in words."""
    plain = annotation.removesuffix(" | None")
    if plain.startswith("Literal"):
        return plain.removeprefix("Literal[").removesuffix("]").replace(", ", " or ")
    words = {
        "int": "whole number", "float": "number", "Path": "file", "Vector": "[x, y, z]",
        "Colour": "[r, g, b]", "tuple[float, float]": "number or [width, height]",
    }  # fmt: skip
    return words[plain]


def _toml(default: object) -> str:
    """A default as the file would have it."""
    if default is None:
        return ""
    if isinstance(default, str):
        return f'`"{default}"`'
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, tuple):
        return f"`[{', '.join(f'{number:.5g}' for number in default)}]`"
    return f"`{default}`"

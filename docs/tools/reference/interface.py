"""What Python programs can call, from signatures and docstrings."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from importlib import import_module

import matcap
from matcap.files.settings import field_docs
from reference.docstrings import read, table

_HEAD = """\
# Python

What `import matcap` offers, then what stands in its modules. [From Python](../guide/python.md)
shows them at work. Maps are torch tensors, float32, channels first, row 0 at the top; lengths are
plane units, half the photograph's long side.
"""
# Beyond `import matcap`: what the guide uses.
MODULES = {
    "matcap.capture.settings": ("CaptureSettings", "resolve"),
    "matcap.capture.run": ("capture_file",),
    "matcap.capture.pipeline": ("capture_photo", "CaptureResult"),
    "matcap.photo.photo": ("Photo",),
    "matcap.flash.geometry": ("FlashSetup",),
    "matcap.brdf.cook_torrance": ("cook_torrance",),
    "matcap.synth.stream": ("synthesise",),
    "matcap.synth.request": ("SynthRequest", "Work"),
    "matcap.field.options": ("ReadOptions",),
    "matcap.relight.scene": (
        "Scene", "Film", "Camera", "Surface", "PointLight", "DirectionalLight", "SphereLight",
        "RectangleLight", "EnvironmentLight",
    ),
    "matcap.relight.render": ("Renderer",),
    "matcap.space.between": ("blend",),
    "matcap.space.prior.store": ("Prior", "load_prior"),
    "matcap.view.document": ("sealed_page",),
    "matcap.view.subject": ("Materials",),
}  # fmt: skip


def page() -> str:
    """The page, in Markdown."""
    lines = [_HEAD, "## matcap", ""]
    for name in matcap.__all__:
        if not name.startswith("_"):
            lines += _thing(f"matcap.{name}", inspect.unwrap(getattr(matcap, name)))
    for module, names in MODULES.items():
        lines += [f"## {module}", ""]
        for name in names:
            lines += _thing(name, getattr(import_module(module), name))
    return "\n".join(lines)


def _thing(name: str, thing: object) -> Iterator[str]:
    """A function or a class, and the methods of the class."""
    yield from ("### " + name, "")
    if inspect.isclass(thing):
        yield from _class(name, thing)
    else:
        yield from _code(_signature(name, thing))
        yield from _described(thing)


def _class(name: str, kind: type) -> Iterator[str]:
    if not is_dataclass(kind):
        yield from _code(_signature(name, kind))
    found = read(kind)
    yield from (found.text, "")
    if is_dataclass(kind):
        documented = field_docs(kind)
        shown = [one for one in fields(kind) if not one.name.startswith("_")]
        yield from table(
            ["field", "type", "default", "what"],
            (
                [f"`{f.name}`", f"`{f.type}`", _default(f), documented.get(f.name, "")]
                for f in shown
            ),
        )
    else:
        yield from _sections(kind)
    for member, method in vars(kind).items():
        if member.startswith("_"):
            continue
        if isinstance(method, property):
            yield from (f"**`.{member}`** {read(method).text}", "")
        elif inspect.isfunction(method) or isinstance(method, staticmethod | classmethod):
            called = getattr(kind, member)
            owner = kind.__name__ if not inspect.isfunction(method) else ""
            yield from _code(_signature(f"{owner}.{member}", called))
            yield from _described(called)


def _described(thing: object) -> Iterator[str]:
    yield from (read(thing).text, "")
    yield from _sections(thing)


def _sections(thing: object) -> Iterator[str]:
    """Args and Raises as tables, the others as they are."""
    found = read(thing)
    for heading, text in found.sections.items():
        entries = found.entries(heading)
        if heading == "Example":
            yield from ("```python", text, "```", "")
        elif heading in ("Args", "Raises", "Attributes"):
            yield from table([heading.lower(), ""], ([f"`{k}`", v] for k, v in entries.items()))
        else:
            yield from (f"{heading}: {text}", "")


def _signature(name: str, thing: object) -> str:
    """`name(arguments) -> result`, an argument a line where it is long."""
    assert callable(thing)
    signature = inspect.signature(thing)
    kept = [one for one in signature.parameters.values() if one.name != "self"]
    parts = [_parameter(one) for one in kept]
    keywords = [one.kind is inspect.Parameter.KEYWORD_ONLY for one in kept]
    if any(keywords):
        parts.insert(keywords.index(True), "*")
    result = "" if inspect.isclass(thing) else f" -> {signature.return_annotation}"
    line = f"{name}({', '.join(parts)}){result}"
    if len(line) <= 100:
        return line
    return "\n".join([f"{name}(", *(f"    {part}," for part in parts), f"){result}"])


def _parameter(one: inspect.Parameter) -> str:
    stars = "**" if one.kind is inspect.Parameter.VAR_KEYWORD else ""
    default = "" if one.default is inspect.Parameter.empty else f" = {_value(one.default)}"
    return f"{stars}{one.name}: {one.annotation}{default}"


def _value(value: object) -> str:
    """A default as code."""
    if isinstance(value, Enum):
        return f"{type(value).__name__}.{value.name}"
    return getattr(value, "__name__", None) or repr(value)


def _default(field: Field[object]) -> str:
    """A field's default as a cell; what has none must be given."""
    if field.default is not MISSING:
        return f"`{_value(field.default)}`"
    return "" if field.default_factory is MISSING else f"`{_value(field.default_factory)}()`"


def _code(text: str) -> tuple[str, ...]:
    return ("```python", text, "```", "")

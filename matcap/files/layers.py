"""Which part and layer of an EXR file is the picture that is meant."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matcap.errors import MatcapError

# Roles of channels by name, in lower case and without the layer.
_ROLES = {
    **{"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"},
    **{"a": "A", "alpha": "A"},
}
_COLOURS = ("R", "G", "B")
_GREYS = ("y", "l", "v", "i", "grey", "gray", "luminance", "value", "intensity")
_AXES = {"x": "R", "y": "G", "z": "B"}  # of vectors, as in Blender's normal pass
# Words in names of layers: of the picture itself, and of data that renderers write beside it.
_PICTURE = ("combined", "beauty", "rgba", "rgb", "color", "colour", "main", "default", "composite")
_DATA = frozenset((
    "depth", "z", "zdepth", "ao", "occlusion", "normal", "normals", "n", "position", "p", "uv",
    "mist", "shadow", "vector", "motion", "velocity", "id", "index", "object", "material", "crypto",
    "cryptomatte", "mask", "matte", "albedo", "denoising", "variance", "noisy", "emit", "emission",
    "diffuse", "diff", "glossy", "gloss", "specular", "transmission", "trans", "volume", "direct",
    "indirect", "dir", "ind", "env", "environment", "roughness", "alpha", "opacity", "samples",
    "debug", "aov", "lpe", "facing", "fresnel", "sheen", "coat", "sss", "subsurface",
))  # fmt: skip


@dataclass(frozen=True)
class ExrLayer:
    """A picture in an EXR file."""

    part: int
    """Index of its part."""
    name: str
    """Name of the part and the layer; "" where neither has one."""
    roles: Mapping[str, int]
    """Index of the channel by role "R", "G", "B", "A"; equal for the colours of a grey picture."""

    @property
    def coloured(self) -> bool:
        """Whether it has at least two channels besides alpha."""
        return self.roles["R"] != self.roles.get("G")


def meant_layer(
    specs: Sequence[Any], wanted: Sequence[str] = (), where: str = ""
) -> tuple[ExrLayer, tuple[str, ...]]:
    """The layer that is meant, and a note on which of several it is.

    First is the one that a `wanted` word names, then what is called combined, beauty or the like,
    then the one without a name, other colours, other greys; passes of data come last.

    Args:
        specs: OpenImageIO's specification of each part.
        wanted: words for the data that the file should hold, such as "normal".
        where: the file, for errors.

    Raises:
        MatcapError: no part has a colour or grey channel; luminance and chroma; deep parts alone.
    """
    flat = [(index, spec) for index, spec in enumerate(specs) if not spec.deep]
    layers = [
        layer for index, spec in flat for layer in _layers(index, spec, len(specs) > 1, where)
    ]
    if not layers:
        deep = not flat
        names = ", ".join(name for spec in specs for name in spec.channelnames)[:80]
        raise MatcapError.at(
            where,
            "this is a deep EXR file, which is not supported"
            if deep
            else f"none of its channels ({names}) is red or grey",
            "flatten it, and save it with one sample a pixel" if deep else "save it as RGB",
        )

    def order(layer: ExrLayer) -> tuple[int, int, int]:
        words = re.findall("[a-z]+", re.sub("(?<=[a-z])(?=[A-Z])", " ", layer.name).lower())
        ranks = [wanted.index(word) for word in words if word in wanted]
        if ranks:
            return 0, min(ranks), not layer.coloured
        called = [_PICTURE.index(word) for word in words if word in _PICTURE]
        if _DATA & set(words):
            return 4, 0, not layer.coloured
        if called and layer.coloured:
            return 1, min(called), 0
        return (2 if layer.coloured else 3), bool(layer.name), 0

    chosen = min(layers, key=order)
    if len(layers) == 1:
        return chosen, ()
    names = ", ".join(layer.name or "one without a name" for layer in layers)[:200]
    return chosen, (
        f"The file holds {len(layers)} pictures ({names}): "
        f"{chosen.name or 'the one without a name'} is read.",
    )


def _layers(index: int, spec: Any, several: bool, where: str) -> list[ExrLayer]:  # noqa: ANN401
    """The layers of a part that have a colour or grey channel."""
    part = str(spec.getattribute("oiio:subimagename") or spec.getattribute("name") or "")
    by_name: dict[str, dict[str, int]] = {}
    for place, name in enumerate(spec.channelnames):
        layer, _, tail = name.rpartition(".")
        by_name.setdefault(layer, {}).setdefault(tail.lower(), place)
    if any({"ry", "by"} & set(tails) for tails in by_name.values()):
        raise MatcapError.at(
            where,
            "this EXR file holds luminance and chroma, which is not supported",
            "save it as RGB",
        )
    layers = []
    alone = len(by_name) == 1
    for layer, tails in by_name.items():
        name = f"{part}.{layer}".strip(".") if several else layer
        if (roles := _roles(tails, alone=alone)) is not None:
            layers.append(ExrLayer(index, name, roles))
    return layers


def _roles(tails: Mapping[str, int], *, alone: bool) -> dict[str, int] | None:
    """Index of the channel by role; None where no channel is a colour or grey.

    Args:
        alone: there is no other layer: a single channel of any name is grey.
    """
    known = _ROLES | (_AXES if {"x", "y"} <= set(tails) else {})
    roles = {known[tail]: place for tail, place in tails.items() if tail in known}
    if "R" in roles:
        return roles if "G" in roles else roles | dict.fromkeys(_COLOURS, roles["R"])
    alpha = next((tail for tail in tails if _ROLES.get(tail) == "A"), None)
    others = {tail: place for tail, place in tails.items() if tail != alpha}
    if not others:
        if not alone:
            return None
        others = dict(tails)
    named = [place for tail, place in others.items() if tail in _GREYS]
    if not named and len(others) > 1:
        return None
    grey = (named or list(others.values()))[0]
    return dict.fromkeys(_COLOURS, grey) | ({} if alpha is None else {"A": tails[alpha]})

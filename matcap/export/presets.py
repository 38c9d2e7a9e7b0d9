"""Loose textures as libraries and engines name and pack them.

A preset is a table: which pictures there are, what each is called, how it is stored and made. The
normal map's direction is part of its name wherever it goes. Read next: libraries.py and engines.py,
the tables.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from matcap.errors import UsageError
from matcap.export.fit import fitted_tables
from matcap.export.formats import Depth, Picture, brightest_channel, mean_channel
from matcap.export.job import ExportJob, MapRows
from matcap.export.metallic import FIRST_METAL, FORMS, Form, Metallic, MetallicAim, to_metallic
from matcap.export.names import known
from matcap.export.options import ExportOptions
from matcap.export.shading import MATCAP, TargetShading
from matcap.export.surface import MadeSurface, Reader, TargetSurface, nearest
from matcap.export.texture_file import TextureFile
from matcap.export.textures import (
    BENT,
    CAVITY,
    CODED_HEIGHT,
    HEIGHT,
    NORMAL,
    OCCLUSION,
    SIGNED_NORMAL,
    Export,
    Workflow,
    coded_height,
    coded_normal,
    coded_normal_dx,
    height_facts,
    occlusion_facts,
    picture,
    signed,
)
from matcap.files.names import is_portable, plain_name, shown

if TYPE_CHECKING:
    from torch import Tensor

NormalMaps = Literal["gl", "dx", "both"]
_FIELDS = ("stem", "map", "res", "format")
_MARGIN = 0.25  # of the plain form's residual, by which another must be nearer
_SHADED = ("occlusion", "cavity", "bent")


@dataclass(frozen=True)
class PackedMaterial:
    """Numbers for a target, of a piece of the maps."""

    piece: MapRows
    """The maps."""
    lit: Lit
    """How the target shades and parametrises them."""

    @property
    def roughness(self) -> Picture:
        """(H, W)."""
        return fitted_tables(self.lit.shading).rough(*self._meant)

    @property
    def f0(self) -> Picture:
        """(H, W) or (H, W, 3) in [0, 1]."""
        return np.clip(fitted_tables(self.lit.shading).f0(*self._meant), 0.0, 1.0)

    @property
    def metallic(self) -> Metallic:
        """The nearest metallic material of the form."""
        low, high = self.lit.dielectric
        f0, rough = self._meant
        share = fitted_tables(self.lit.shading).albedo(np.clip(f0, low, high), rough)
        diffuse = self.piece.picture("diffuse") * share
        wanted = MetallicAim(diffuse, self.f0, rough, low, high, self.lit.below)
        return to_metallic(wanted, self.lit.form)

    @property
    def base(self) -> Picture:
        """(H, W, 3) base colour below any F0."""
        share = fitted_tables(self.lit.shading).albedo(*self._meant)
        if self.lit.conserving:
            share = share / np.maximum(1.0 - brightest_channel(self.f0), 1e-6)[..., None]
        return np.clip(self.piece.picture("diffuse") * share, 0.0, 1.0)

    @property
    def _meant(self) -> tuple[Picture, Picture]:
        return self.piece.picture("specular"), self.piece.picture("roughness")


@dataclass(frozen=True)
class Lit:
    """How an engine takes its textures as a reflectance."""

    shading: TargetShading
    """Of the engine."""
    workflow: Workflow
    """What its textures are."""
    dielectric: tuple[float, float] = (0.0, 1.0)
    """(lowest, highest) F0 of what is no metal; of the metallic workflow."""
    below: float = 1.0
    """Share of the base colour that is diffuse, likewise."""
    conserving: bool = False
    """The base colour is multiplied by 1 - F0; of the specular workflow."""
    even: float | None = None
    """The largest F0 that the material as a whole can give its dielectrics; None where the engine
    does not let it."""
    form: Form = "plain"
    """Of the metallic workflow."""

    def of(self, job: ExportJob) -> Lit:
        """With the mean F0 of the maps' dielectrics where the engine has one for all."""
        if self.even is None:
            return self
        mean = mean_channel(job.specular)
        plain = mean[mean < FIRST_METAL]
        f0 = min(float(plain.mean()) if plain.size else self.dielectric[0], self.even)
        return replace(self, dielectric=(f0, f0))

    def nearest(self, job: ExportJob, surface: Callable[[Lit], MadeSurface]) -> Lit:
        """With the metallic form that comes nearest; `surface` is what comes of each.

        It stays the plain one unless much is gained: a leather that is a little metal may come
        nearer in light, and takes on a metal's tinted reflection.
        """
        forms = [replace(self, form=form) for form in FORMS]
        return forms[nearest(job, [surface(one) for one in forms], _MARGIN)]


@dataclass(frozen=True)
class PresetTexture:
    """One picture of a preset."""

    label: str
    """What {map} becomes in its name."""
    depth: Depth
    """How it is stored unless the user says otherwise."""
    make: Callable[[PackedMaterial], Picture]
    """Its values, fitted to the target's shading; None for maps as they are."""
    meaning: str
    """Of its values, for the sidecar."""
    srgb: bool | None = False
    """A PNG of it carries the sRGB curve; None: where it is F0 with a colour."""


# Text documents that go beside the textures: of the job, the textures' names by kind, and the
# engine.
Documents = Callable[[ExportJob, dict[str, str], Lit], dict[str, str]]


@dataclass(frozen=True)
class Preset:
    """How a library or an engine wants its textures."""

    pattern: str
    """Of file names, without suffix; fields stem, map, res and format."""
    textures: dict[str, PresetTexture]
    """By what --maps calls them; "height" and "normal" are made here."""
    normal: NormalMaps = "gl"
    """The direction it wants."""
    normal_labels: tuple[str, str] = ("normal_gl", "normal_dx")
    """What {map} becomes for normals with +Y up and down."""
    thousand: str = "k"
    """The letter for 1024 in {res}."""
    lit: Lit | None = None
    """How an engine takes them; None for a library."""
    notes: tuple[str, ...] = ()
    """What users must know, a sentence each."""
    documents: Documents | None = None
    """What goes beside the textures."""


def plain(kind: str) -> Callable[[PackedMaterial], Picture]:
    """Makes a map as it is."""
    return lambda material: material.piece.picture(kind)


def height(label: str, depth: Depth = "16") -> PresetTexture:
    """The height, coded by one range where it is in whole numbers."""
    return PresetTexture(label, depth, plain("height"), CODED_HEIGHT)


def normal(depth: Depth = "16") -> PresetTexture:
    """The normal, in the preset's direction."""
    return PresetTexture("", depth, plain("normal"), NORMAL)


def occlusion(label: str, depth: Depth = "8") -> PresetTexture:
    """Ambient occlusion."""
    return PresetTexture(label, depth, plain("occlusion"), OCCLUSION)


def cavity(label: str, depth: Depth = "8") -> PresetTexture:
    """Occlusion by the nearest neighbours."""
    return PresetTexture(label, depth, plain("cavity"), CAVITY)


def bent(label: str, depth: Depth = "8") -> PresetTexture:
    """Bent normals, +Y up."""

    def made(material: PackedMaterial) -> Picture:
        return np.float32(0.5) + np.float32(0.5) * material.piece.picture("bent")

    return PresetTexture(label, depth, made, f"{BENT}, +Y up (OpenGL)")


def pack(job: ExportJob, preset: Preset, choice: ExportOptions | None = None) -> Export:
    """The textures of a preset.

    Raises:
        UsageError: no such map or field of a name; a name that leaves the folder, or two pictures
            of one name.
    """
    choice = choice or ExportOptions()
    wanted = [known(one, preset.textures, "--maps") for one in choice.maps]
    pattern = _checked(choice.pattern or preset.pattern)
    lit = preset.lit and _chosen(job, preset, preset.lit.of(job))
    packed: dict[str, tuple[str, TextureFile]] = {}
    for kind, texture in preset.textures.items():
        if wanted and kind not in wanted:
            continue
        if kind == "normal":
            for way in _ways(choice.normal or preset.normal):
                made = _normal(job, texture.depth, dx=way == "dx")
                packed[f"normal_{way}"] = preset.normal_labels[way == "dx"], made
        elif kind == "height":
            packed[kind] = texture.label, _height(job, texture)
        else:
            packed[kind] = texture.label, _made(job, lit, texture)
    names = _names(job, packed, pattern, preset.thousand)
    textures = {names[kind]: made for kind, (_, made) in packed.items()}
    surfaces: dict[str, MadeSurface] = {}
    documents: dict[str, Callable[[Path], bytes]] = {}
    if lit is not None and not wanted:
        kinds = {kind: made for kind, (_, made) in packed.items()}
        surfaces = {lit.workflow: partial(_surface, lit, kinds)}
    if preset.documents is not None and lit is not None and not wanted:
        texts = preset.documents(job, names, lit)
        documents = {name: _encoded(text) for name, text in texts.items()}
    facts = _facts(job, preset, wanted) | {"textures": names}
    if lit is not None and lit.workflow == "metallic":
        facts["metallic"] = lit.form
    return Export(textures, documents, surfaces, preset.notes, facts)


def _chosen(job: ExportJob, preset: Preset, lit: Lit) -> Lit:
    """With the metallic form that comes nearest, of a metallic workflow."""

    def surface(tried: Lit) -> MadeSurface:
        made = {
            kind: _made(job, tried, texture)
            for kind, texture in preset.textures.items()
            if kind not in (*_SHADED, "height", "normal")
        }
        return partial(_surface, tried, made | {"normal_gl": _normal(job, "16", dx=False)})

    return lit.nearest(job, surface) if lit.workflow == "metallic" else lit


def _names(
    job: ExportJob, packed: dict[str, tuple[str, TextureFile]], pattern: str, thousand: str
) -> dict[str, str]:
    """File names by kind.

    Raises:
        UsageError: two of them are the same.
    """
    res = _resolution(job, thousand)
    names: dict[str, str] = {}
    for kind, (label, made) in packed.items():
        fields = {"stem": job.name, "map": label, "res": res, "format": made.container.upper()}
        name = plain_name(pattern.format(**fields), what="the file name", where="--name")
        if not is_portable(name):
            raise UsageError(
                f"other programs may misread the file name {shown(name)}",
                where="--name",
                remedy="use letters, digits, spaces and _ . , ( ) + -",
            )
        file = name + made.suffix
        if file in names.values():
            raise UsageError(
                f"two maps are called {file}", where="--name", remedy="put {map} into the name"
            )
        names[kind] = file
    return names


def _encoded(text: str) -> Callable[[Path], bytes]:
    return lambda _: text.encode()


def _facts(job: ExportJob, preset: Preset, wanted: Sequence[str]) -> dict[str, Any]:
    there = wanted or list(preset.textures)
    facts: dict[str, Any] = {}
    if "height" in there:
        depth = _height(job, preset.textures["height"]).whole
        facts |= height_facts(job, *(job.height_code if depth else (1.0, 0.0)))
    if set(there) & {*_SHADED, "orm", "mask", "arm"}:
        facts |= occlusion_facts(job)
    return facts


def _made(job: ExportJob, lit: Lit | None, texture: PresetTexture) -> TextureFile:
    source = lit or Lit(MATCAP, "specular")

    def make(piece: MapRows) -> Picture:
        return texture.make(PackedMaterial(piece, source))

    srgb = job.coloured if texture.srgb is None else texture.srgb
    return TextureFile.of(job, make, texture.depth, texture.meaning, srgb=srgb)


def _height(job: ExportJob, texture: PresetTexture) -> TextureFile:
    """Whole numbers hold the coded height; floats the height itself."""
    made = TextureFile.of(job, coded_height, texture.depth, CODED_HEIGHT, lossy=False)
    if made.whole:
        return made
    return TextureFile.of(job, picture("height"), texture.depth, HEIGHT, lossy=False)


def _normal(job: ExportJob, depth: Depth, *, dx: bool) -> TextureFile:
    """Whole numbers hold 0.5 + 0.5 n, floats n itself."""
    up = "+Y down (DirectX)" if dx else "+Y up (OpenGL)"
    make = coded_normal_dx if dx else coded_normal
    made = TextureFile.of(job, make, depth, f"{NORMAL}, {up}")
    if made.whole:
        return made
    return TextureFile.of(
        job, lambda piece: 2.0 * make(piece) - 1.0, depth, f"{SIGNED_NORMAL}, {up}"
    )


def _ways(normal: NormalMaps) -> tuple[Literal["gl", "dx"], ...]:
    return ("gl", "dx") if normal == "both" else (normal,)


def _surface(lit: Lit, textures: dict[str, TextureFile], read: Reader) -> TargetSurface:
    """What an engine makes of the packed textures."""
    seen = {kind: read(made) for kind, made in textures.items() if kind not in (*_SHADED, "height")}
    base = seen["base"]
    bent = _seen_normal(textures, seen)
    if lit.workflow == "specular":
        f0 = seen["specular"][:3]
        below = 1.0 - f0.amax(dim=0, keepdim=True) if lit.conserving else 1.0
        return TargetSurface(
            base * below, f0, _seen_roughness(seen), bent, layer=f0, shading=lit.shading
        )
    channel = 2 if "orm" in seen else 0
    packed = next(seen[kind] for kind in ("orm", "mask", "smooth") if kind in seen)
    metallic = packed[channel : channel + 1]
    if "specular" in seen:
        dielectric = lit.dielectric[1] * seen["specular"][:1]
    else:
        dielectric = metallic * 0.0 + lit.dielectric[0]
    return TargetSurface(
        lit.below * base * (1.0 - metallic),
        dielectric * (1.0 - metallic) + base * metallic,
        _seen_roughness(seen),
        bent,
        layer=dielectric,
        shading=lit.shading,
    )


def _seen_roughness(seen: dict[str, Tensor]) -> Tensor:
    """From ORM's green, or smoothness in an alpha."""
    if "orm" in seen:
        return seen["orm"][1:2]
    if "roughness" in seen:
        return seen["roughness"][:1]
    smooth = next(seen[kind] for kind in ("mask", "smooth", "specular") if kind in seen)
    return 1.0 - smooth[3:4]


def _seen_normal(textures: dict[str, TextureFile], seen: dict[str, Tensor]) -> Tensor:
    kind = "normal_dx" if "normal_dx" in seen else "normal_gl"
    bent = signed(seen[kind]) if textures[kind].whole else seen[kind]
    sign = [1.0, -1.0 if kind == "normal_dx" else 1.0, 1.0]
    return bent * bent.new_tensor(sign)[:, None, None]


def _checked(pattern: str) -> str:
    """The pattern itself, every field of it known."""
    try:
        for _, field, width, conversion in Formatter().parse(pattern):
            if field is not None:
                known(field, _FIELDS, "--name")
            if width or conversion:
                raise ValueError(f"'{field}' is put in as it is, without a width or a conversion")
    except ValueError as error:
        raise UsageError(
            f"'{pattern}' is no pattern ({error})",
            where="--name",
            remedy="write it like '{stem}_{map}_{res}'",
        ) from error
    return pattern


def _resolution(job: ExportJob, thousand: str) -> str:
    """The long side: "2k" for 2048, "600" for 600."""
    side = max(job.maps.size)
    return f"{side // 1024}{thousand}" if side % 1024 == 0 else str(side)

"""Map sets of other programs as a texture to relight: channels decoded, normals, one size."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from matcap.brdf.edited import check_heights
from matcap.brdf.heights import integrate_periodic, resized_height
from matcap.brdf.stated import NormalStyle
from matcap.errors import MatcapError
from matcap.files.pixels import Pixels, linear_colours, read_pixels
from matcap.relight.camera import Array
from matcap.relight.foreign.names import (
    OBJECT_SPACE,
    READ_SUFFIXES,
    NamedFile,
    SetFiles,
    assigned,
    stated_export,
    usual_style,
    words_of,
)
from matcap.relight.texture import Texture

# Decode normal maps of other programs, and determine which way their green points.

_STEEPEST = 20.0  # largest slope that 8 bits resolve
_STEP = 2.0 / 255.0  # range below which a channel is constant
_UNIT = 0.05  # largest mean deviation of vectors' length from 1
_NEGATIVE = 0.01  # largest share of negative texels in a map stored as 0.5 + 0.5 n
_FACING_DOWN = 0.3  # largest share of normals with z <= 0
_LEANING = 0.5  # least z of the mean normal's direction; a tangent-space map's faces the viewer
_OTHER = 0.1  # mean difference of blue from z = sqrt(1 - x^2 - y^2) above which it may be no z
_FOLLOWS = 0.5  # correlation of blue with that z below which it is none
_CLEARLY = 0.9  # ratio of the curls above which the test is undecided
_SAMPLE = 1_000_000  # texels from which a map's encoding is determined


def slopes_of(pixels: Pixels) -> tuple[Array, tuple[str, ...]]:
    """(2, H, W) dh/dx and dh/dy of a normal map, y along its green; and notes.

    Integers are 0.5 + 0.5 n. Floats are that or n itself, whichever gives vectors of length 1. If
    blue is missing, constant or other data (occlusion), z = sqrt(1 - x^2 - y^2). If red is constant
    and alpha is not, x is in alpha (DXT5nm compression).

    Raises:
        MatcapError: a single channel, or normals that are not in tangent space.
    """
    name = pixels.path.name
    if pixels.grey:
        raise MatcapError.at(
            pixels.path,
            "has one channel, and a normal map needs two",
            "remove it, or name it as height if that is what it is",
        )
    x, y = pixels.channel("R"), pixels.channel("G")
    z = pixels.channel("B") if "B" in pixels.roles else None
    notes = []
    if "A" in pixels.roles and _constant(x) and not _constant(y):
        alpha = pixels.channel("A")
        if not _constant(alpha):
            x, z = alpha, None
            notes.append(f"{name}: x is taken from alpha, y from green")
    if pixels.whole or _coded(x, y, z):
        x, y = 2.0 * x - 1.0, 2.0 * y - 1.0
        z = None if z is None else 2.0 * z - 1.0
    if z is not None and _constant(z) and not (_constant(x) and _constant(y)):
        unit = np.abs(np.sqrt(x * x + y * y + z * z) - 1.0).mean() < _UNIT
        z = z if unit and float(z.flat[0]) > 0.0 else None
    if z is None:
        notes.append(f"{name}: z is computed from x and y")
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
    facing_down = float((z <= 0.0).mean())
    mean = np.array([float(one.mean()) for one in (x, y, z)])
    if facing_down > _FACING_DOWN or mean[2] < _LEANING * float(np.linalg.norm(mean)):
        raise MatcapError.at(
            pixels.path,
            f"{100 * facing_down:.0f} % of its normals point away from the surface and their mean "
            f"is ({mean[0]:.2f}, {mean[1]:.2f}, {mean[2]:.2f}), so it is of object or world space",
            "bake it in tangent space",
        )
    if "B" in pixels.roles and facing_down > 1e-3 and _is_other(x, y, z):
        notes.append(f"{name}: blue holds other data than z, which is computed from x and y")
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
        facing_down = 0.0
    if facing_down > 1e-3:
        notes.append(
            f"{name}: {100.0 * facing_down:.1f} % of its normals point away from the viewer; "
            f"their slope is limited to {_STEEPEST:g}"
        )
    z = np.maximum(z, 1.0 / _STEEPEST)
    slopes = np.stack([-x / z, -y / z])
    # Limit the slope also where x and y are too large for a unit vector.
    length = np.sqrt((slopes * slopes).sum(0))
    return slopes * np.minimum(1.0, _STEEPEST / np.maximum(length, 1e-9)), tuple(notes)


def looks_like_normals(pixels: Pixels) -> bool:
    """Whether a picture's median colour is that of a normal map: bluish, of length 1."""
    if pixels.grey or not pixels.whole or "B" not in pixels.roles:
        return False
    n = [2.0 * _sample(pixels.channel(role)) - 1.0 for role in ("R", "G", "B")]
    length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    x, y, z, unit = (float(np.median(one)) for one in (*n, length))
    return z > 0.5 and max(abs(x), abs(y)) < 0.2 and abs(unit - 1.0) < 0.1


def style_of(slopes: Array, rise: Array | None, usual: NormalStyle) -> NormalStyle:
    """Determine which way green points: "gl" up, "dx" down.

    By correlation with the height map's slopes; without one by the curl, which is 0 for the
    gradient of a surface. Reliefs f(x) + g(y) have no curl either way: then `usual`.

    Args:
        slopes: (2, H, W) dh/dx, and dh/dy along green.
        rise: (2, H, W) slopes of the height map, y up; None without one.
        usual: direction that the files' naming suggests.
    """
    if rise is not None and (rise[1] * slopes[1]).any():
        return "gl" if (rise[1] * slopes[1]).sum() >= 0.0 else "dx"

    def curl(sign: float) -> float:
        # d(dh/dx)/dy - d(dh/dy)/dx; rows run downwards.
        twist = np.roll(slopes[0], 1, 0) - np.roll(slopes[0], -1, 0)
        twist = twist - sign * (np.roll(slopes[1], -1, 1) - np.roll(slopes[1], 1, 1))
        return float((twist * twist).mean())

    up, down = curl(1.0), curl(-1.0)
    if min(up, down) >= _CLEARLY * max(up, down):
        return usual
    return "gl" if up < down else "dx"


def gradient(height: Array, texel: float) -> Array:
    """(2, H, W) dh/dx and dh/dy of a repeating height (1, H, W), y up: central differences."""
    field = height[0]
    across = (np.roll(field, -1, 1) - np.roll(field, 1, 1)) / (2.0 * texel)
    up = (np.roll(field, 1, 0) - np.roll(field, -1, 0)) / (2.0 * texel)
    return np.stack([across, up])


def _coded(x: Array, y: Array, z: Array | None) -> bool:
    """Whether floats are 0.5 + 0.5 n rather than n, by the median texel."""
    if z is None:
        return bool(max(float((one < 0.0).mean()) for one in (x, y)) < _NEGATIVE)
    n = np.stack([_sample(one) for one in (x, y, z)])
    plain, coded = (
        float(np.median(np.abs(np.sqrt((one * one).sum(0)) - 1.0))) for one in (n, 2.0 * n - 1.0)
    )
    return coded < plain


def _sample(plane: Array) -> Array:
    return plane.reshape(-1)[:: max(1, plane.size // _SAMPLE)]


def _is_other(x: Array, y: Array, z: Array) -> bool:
    """Whether z does not follow from x and y, as where it is ambient occlusion."""
    unit = np.sqrt(np.maximum(1.0 - _sample(x) ** 2 - _sample(y) ** 2, 0.0))
    stored = _sample(z)
    if float(np.abs(stored - unit).mean()) < _OTHER or float(unit.std()) == 0.0:
        return False
    return float(np.corrcoef(stored, unit)[0, 1]) < _FOLLOWS


def _constant(plane: Array) -> bool:
    return bool(float(plane.max()) - float(plane.min()) < _STEP)


# Map sets of other programs as a texture to relight.
#
# - Metallic workflow: diffuse = base (1 - metallic), F0 = 0.04 (1 - metallic) + base metallic.
# - Specular workflow (specular and gloss without metallic): the specular map is F0.
# - Height maps have no unit: they are scaled to fit the normal map's slopes by least squares.
#   Without a height map the normal map is integrated (brdf/maps.py).
# - A set is two plane units wide, unless it is matcap's export, whose sidecar states the size.

_LEVEL = 0.08  # F0 of specular level 1 [burley2012]
# Height range over width, assumed without a normal map.
_ASSUMED_RELIEF = 0.02
_METALS = frozenset(
    ("metal", "steel", "iron", "gold", "silver", "copper", "brass", "bronze", "chrome", "aluminium",
     "aluminum", "titanium", "zinc", "tin")
)  # fmt: skip
_COLOURED_SHARE = 0.01  # of texels from which on a specular map is coloured
_FLAT = 1e-6  # relative range below which a height map is flat

DIELECTRIC = 0.04  # F0 of dielectrics where a set states none
_COLOURED = 0.02  # mean difference between channels above which a picture is coloured
_MOST_FOLDERS = 50  # that are looked into
_SHAPE = 0.02  # largest relative difference of the maps' aspect ratios


@dataclass(frozen=True)
class Foreign:
    """A map set read for relighting."""

    texture: Texture
    notes: tuple[str, ...]
    """What was guessed or not used, a sentence each."""
    files: Mapping[str, str]
    """File names by map."""


def read_foreign(folder: str | Path, *, normal: NormalStyle | None = None) -> Foreign:
    """Read the maps in a folder, by their file names or by the sidecar of matcap's export.

    Args:
        normal: direction of the normal map's green where no name states it: "gl" up, "dx" down.

    Raises:
        MatcapError: no folder, no base colour in it, two files for one map, maps of different
            aspect ratios, a picture that cannot be read or used; as check_heights.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MatcapError.at(folder, "no such folder", "check the path")
    about = stated_export(folder) or assigned(folder)
    spatial = [line for line in about.left_out if f"({OBJECT_SPACE})" in line]
    if spatial and "normal" not in about.files:
        raise MatcapError.at(
            folder,
            f"its only normal map is of object or world space ({', '.join(spatial)})",
            "bake it in tangent space, or remove it",
        )
    if "base" not in about.files:
        unused = f" (not used: {', '.join(about.left_out)})" if about.left_out else ""
        inside = ", ".join(_folders_of_maps(folder))
        raise MatcapError.at(
            folder,
            f"there is no map of base colour in this folder{unused}",
            f"give the folder that holds it ({inside})"
            if inside
            else "name one ..._Color, ..._diff, ..._albedo or ..._basecolor",
        )
    maps = ForeignMaps.of(about)
    texture = maps.texture(normal)
    check_heights(texture.height, str(folder))
    files = {kind: file.path.name for kind, file in maps.files.items()}
    return Foreign(texture, tuple(maps.notes), files)


def _folders_of_maps(folder: Path) -> list[str]:
    """Names of the folders in a folder that hold pictures, the first three."""
    inside = sorted(one for one in folder.iterdir() if one.is_dir() and one.name[0] not in "._")
    with_pictures = [
        one.name
        for one in inside[:_MOST_FOLDERS]
        if any(file.suffix.lower() in READ_SUFFIXES for file in one.iterdir())
    ]
    return with_pictures[:3]


@dataclass
class ForeignMaps:
    """A set while it is read; each file is opened once."""

    about: SetFiles
    """The files, and what is stated of them."""
    files: dict[str, NamedFile]
    """Files by map; unusable ones are removed."""
    left_out: list[str]
    """Files that are not used, with the reason."""
    notes: list[str] = field(default_factory=list)
    """What was guessed or not used, a sentence each."""
    _opened: dict[Path, Pixels] = field(default_factory=dict)

    @staticmethod
    def of(about: SetFiles) -> ForeignMaps:
        """The usable maps of these files."""
        maps = ForeignMaps(about, dict(about.files), left_out=[*about.left_out])
        maps._leave_out_what_is_not_there()
        maps._judge_height()
        return maps

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height) of all maps once they are read: the largest's."""
        sizes = [self._pixels(k).size for k in ("base", "normal", "height") if k in self.files]
        return max(sizes, key=lambda one: one[0] * one[1])

    def texture(self, normal: NormalStyle | None) -> Texture:
        """The material, with notes."""
        roughness = self._roughness()
        diffuse, specular = self._reflectance()
        texel = 2.0 / self.size[0] if self.about.texel is None else self.about.texel
        height, slopes = self._relief(texel, normal)
        if self.left_out:
            self.notes.append(f"not used: {', '.join(self.left_out)}")
        maps = (diffuse, specular, roughness, height, slopes)
        a, b, c, d, e = (np.ascontiguousarray(one, dtype=np.float32) for one in maps)
        return Texture(a, b, c, d, e, texel, self.about.periodic)

    def _uniform(self, value: float) -> Array:
        """(1, H, W) of one value."""
        return np.full((1, *self.size[::-1]), value, np.float32)

    def _pixels(self, kind: str) -> Pixels:
        path = self.files[kind].path
        if path not in self._opened:
            words = (word for one in self.files[kind].channels for word in words_of(one))
            pixels = read_pixels(path, wanted=tuple(words))
            self.notes += [f"{path.name}: {note}" for note in pixels.notes]
            self._opened[path] = pixels
        return self._opened[path]

    def _leave_out_what_is_not_there(self) -> None:
        """Remove packed maps whose channel the file lacks: MetallicSmoothness without alpha."""
        for kind, file in list(self.files.items()):
            role = file.channels[kind]
            if role != "RGB" and role not in self._pixels(kind).roles:
                self.notes.append(
                    f"{file.path.name}: has no channel {role}, which should hold {kind}"
                )
                del self.files[kind]

    def _judge_height(self) -> None:
        """Reclassify a file named as height (Unity's BumpMap) whose colours are a normal map's."""
        if "height" not in self.files or not looks_like_normals(self._pixels("height")):
            return
        file = self.files.pop("height")
        if "normal" in self.files:
            self.left_out.append(f"{file.path.name} (a normal map by its colours)")
            return
        self.files["normal"] = NamedFile(file.path, {"normal": "RGB"})
        self.notes.append(f"{file.path.name} is read as a normal map, by its colours")

    def colour(self, kind: str) -> Array | None:
        """(3, H, W) linear Rec.709, clipped to [0, 1]."""
        if kind not in self.files:
            return None
        pixels = self._pixels(kind)
        colours, notes = linear_colours(pixels, named=self.files[kind].space)
        self.notes += [f"{pixels.path.name}: {note}" for note in notes]
        if "A" in pixels.roles and "A" not in self.files[kind].channels.values():
            opaque = float(pixels.channel("A").min()) >= 0.999
            if not opaque:
                self.notes.append(f"{pixels.path.name}: its transparency is not used")
        return self._fitted(self._clipped(np.moveaxis(colours, -1, 0), pixels), pixels)

    def scalar(self, kind: str) -> Array | None:
        """(1, H, W) of the map's channel, clipped to [0, 1]."""
        if kind not in self.files:
            return None
        pixels, role = self._pixels(kind), self.files[kind].channels[kind]
        self._note_colours(pixels, self.files[kind])
        return self._fitted(self._clipped(pixels.channel(role)[None], pixels), pixels)

    def _roughness(self) -> Array:
        """(1, H, W) of its own map, else 1 - gloss, else 0.5."""
        roughness, gloss = self.scalar("roughness"), self.scalar("gloss")
        if roughness is not None:
            paths = (file.path for kind, file in self.files.items() if kind != "gloss")
            if gloss is not None and self.files["gloss"].path not in paths:
                self.left_out.append(f"{self.files['gloss'].path.name} (roughness is taken)")
            return roughness
        if gloss is None:
            self.notes.append("no roughness map: 0.5 everywhere")
            return self._uniform(0.5)
        return 1.0 - gloss

    def _reflectance(self) -> tuple[Array, Array]:
        """(3, H, W) diffuse albedo and (1 or 3, H, W) F0."""
        about, exact = self.about, self.about.texel is not None
        base, metallic = self.colour("base"), self.scalar("metallic")
        assert base is not None
        specular, level = self.colour("specular"), self.scalar("specular level")
        name = self.files["specular"].path.name if "specular" in self.files else ""
        glossy = "gloss" in self.files and metallic is None
        coloured = self.files["base"].diffuse and metallic is None and _is_coloured(specular)
        if specular is not None and (exact or glossy or coloured):
            if not exact:
                why = "the set has gloss" if glossy else "it is coloured, beside a diffuse map"
                self.notes.append(f"{name} is read as F0, since {why}")
            # F0 with gloss in alpha is Unity's and glTF's, which use base (1 - F0).
            if about.conserving or "gloss" in self.files["specular"].channels:
                base = base * (1.0 - specular.max(axis=0, keepdims=True))
            grey = np.ptp(specular, axis=0).max() < 1e-6
            return base, specular[:1] if grey else specular
        if specular is not None:
            self.notes.append(f"not used: {name} (F0 of dielectrics is 0.04)")
        plain = DIELECTRIC if level is None else _LEVEL * level
        if metallic is None:
            if _METALS & set(re.findall("[a-z]+", self.files["base"].path.name.lower())):
                note = "no metallic map: read as dielectric, though its name is a metal's"
                self.notes.append(note)
            metallic = self._uniform(0.0)
        both = metallic_of(base, metallic, plain)
        return both[:3], both[3:] if metallic.any() else both[3:4]

    def _relief(self, texel: float, style: NormalStyle | None) -> tuple[Array, Array]:
        """(1, H, W) heights and (2, H, W) slopes of the shading normal."""
        height, whole = self._height()
        slopes = self.slopes(height, texel, style)
        if height is None:
            if slopes is not None:
                self.notes.append("no height map: the normal map was integrated")
                return integrate_periodic(slopes, texel), slopes
            self.notes.append("neither normal nor height map: the surface is flat")
            return self._uniform(0.0), self._uniform(0.0).repeat(2, axis=0)
        if np.ptp(height) <= _FLAT * max(1.0, float(np.abs(height).max())):
            self.notes.append(f"the height map is flat ({self.files['height'].path.name})")
            height = np.zeros_like(height)
        elif self.about.texel is not None:  # in stated units
            pass
        elif slopes is not None:
            height = height * _scale(height, slopes, texel, self.notes)
        else:
            span = 1.0 if whole else float(np.ptp(height))
            height = height * np.float32(_ASSUMED_RELIEF * 2.0 / span)
            self.notes.append(
                f"no normal map: the heights are assumed to span {_ASSUMED_RELIEF:g} of the width"
            )
        return height, gradient(height, texel) if slopes is None else slopes

    def _height(self) -> tuple[Array | None, bool]:
        """(1, H, W), in plane units where the sidecar states them; and whether it is of integers,
        here [0, 1] of their range.
        """
        if "height" not in self.files:
            return None, False
        pixels, file = self._pixels("height"), self.files["height"]
        self._note_colours(pixels, file)
        values = pixels.channel(file.channels["height"])[None]
        height = self._fitted(values, pixels, heights=True)
        if self.about.height is not None:
            scale, midlevel = self.about.height
            height = (height - np.float32(midlevel)) * np.float32(scale)
        return height, pixels.whole

    def slopes(self, height: Array | None, texel: float, style: NormalStyle | None) -> Array | None:
        """(2, H, W) dh/dx and dh/dy of the normal map, y up."""
        if "normal" not in self.files:
            return None
        file, pixels = self.files["normal"], self._pixels("normal")
        raw_slopes, notes = slopes_of(pixels)
        self.notes += notes
        slopes = self._fitted(raw_slopes, pixels)
        if style is not None and file.style not in ("", style):
            self.notes.append(
                f"{file.path.name}: its name says {file.style}, so --normal {style} is not used"
            )
        named = file.style or style
        if named is None:
            rise = None if height is None else gradient(height, texel)
            named = style_of(slopes, rise, usual_style(self.files.values()))
            self.notes.append(
                f"{file.path.name} does not say which way green points: assumed +Y "
                f"{'up (gl)' if named == 'gl' else 'down (dx)'}; --normal sets it"
            )
        return slopes * np.array([1.0, 1.0 if named == "gl" else -1.0], np.float32)[:, None, None]

    def _note_colours(self, pixels: Pixels, file: NamedFile) -> None:
        if len(file.channels) > 1 or pixels.grey or "B" not in pixels.roles:
            return
        red, *others = (pixels.channel(role) for role in ("R", "G", "B"))
        if max(float(np.abs(red - one).mean()) for one in others) > _COLOURED:
            self.notes.append(f"{pixels.path.name}: is coloured; its red channel is used")

    def _clipped(self, values: Array, pixels: Pixels) -> Array:
        clipped: Array = np.clip(values, 0.0, 1.0).astype(np.float32, copy=False)
        if not pixels.whole:
            off = float(np.abs(clipped - values).max())
            if off > 1e-3:
                self.notes.append(f"{pixels.path.name}: values outside of 0 to 1 are clipped")
        return clipped

    def _fitted(self, values: Array, pixels: Pixels, *, heights: bool = False) -> Array:
        """(C, H, W) resampled to the set's (width, height): area mean down, bilinear up.

        Heights keep their slopes: bilinear ones are facets.

        Raises:
            MatcapError: another aspect ratio.
        """
        size, (height, width) = self.size, values.shape[1:]
        if (width, height) == size:
            return np.ascontiguousarray(values, dtype=np.float32)
        if min(width, height) > 1 and abs(width * size[1] / (height * size[0]) - 1.0) > _SHAPE:
            raise MatcapError.at(
                pixels.path,
                f"is {width} x {height} pixels, another aspect ratio than {size[0]} x {size[1]}, "
                "the largest map's",
                "give maps of the same extent",
            )
        planes = values.astype(np.float32)
        if heights:
            return np.stack([resized_height(plane, size) for plane in planes])
        way = cv2.INTER_AREA if width > size[0] else cv2.INTER_LINEAR
        return np.stack([cv2.resize(plane, size, interpolation=way) for plane in planes])


def metallic_of(base: Array, metallic: Array, dielectric: Array | float = DIELECTRIC) -> Array:
    """(6, H, W) diffuse albedo and F0 of base colour (3, H, W) and metallic (1, H, W)."""
    specular = dielectric * (1.0 - metallic) + base * metallic
    return np.concatenate([base * (1.0 - metallic), specular])


def _is_coloured(specular: Array | None) -> bool:
    """Whether a specular map has colours, as F0 of metals has."""
    if specular is None:
        return False
    return float((np.ptp(specular, axis=0) > _COLOURED).mean()) > _COLOURED_SHARE


def _scale(height: Array, slopes: Array, texel: float, notes: list[str]) -> np.float32:
    """Factor on a height map that fits its slopes to the normal map's by least squares."""
    own = gradient(height, texel)
    power = float((own * own).sum())
    scale = float((own * slopes).sum()) / power if power > 0.0 else 0.0
    if scale <= 0.0:
        notes.append("the height map contradicts the normal map and is not used")
        return np.float32(0.0)
    notes.append(f"height scaled by {scale:.3g} to fit the normal map")
    return np.float32(scale)

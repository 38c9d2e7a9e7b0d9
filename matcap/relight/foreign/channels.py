"""Read the maps of another program's set: decoded, one size, missing ones None (see read.py)."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from matcap.brdf.stated import NormalStyle
from matcap.errors import MatcapError
from matcap.files.pixels import Pixels, linear_colours, read_pixels
from matcap.files.udim import TOKEN, tile_names
from matcap.relight.foreign.exported import stated_export
from matcap.relight.foreign.names import NamedFile, SetFiles, assigned, usual_style
from matcap.relight.foreign.normals import gradient, looks_like_normals, slopes_of, style_of
from matcap.relight.vectors import Array

DIELECTRIC = 0.04  # F0 of dielectrics where a set states none
_COLOURED = 0.02  # mean difference between channels above which a picture is coloured
_SHAPE = 0.02  # largest relative difference of the maps' aspect ratios


@dataclass(frozen=True)
class SetChannels:
    """The maps of a set, float32 and all of one size; None where the set lacks one."""

    base: Array
    """(3, H, W) base colour, or diffuse albedo in sets with F0; linear Rec.709, [0, 1]."""
    roughness: Array | None
    """(1, H, W) perceptual; of its own map, or 1 - gloss."""
    metallic: Array | None
    """(1, H, W), [0, 1]."""
    specular: Array | None
    """(3, H, W) F0, linear."""
    level: Array | None
    """(1, H, W) specular level: F0 of dielectrics over 0.08."""
    dielectric: float
    """F0 of dielectrics where there is no `level`."""
    height: Array | None
    """(1, H, W); in plane units if `exact`, else as stored."""
    whole: bool
    """Heights are stored as integers, here [0, 1] of their range."""
    slopes: Array | None
    """(2, H, W) dh/dx and dh/dy of the normal map, y up."""
    texel: float
    """A texel's side in plane units."""
    exact: bool
    """Heights and texel have stated units, not assumed ones."""
    conserving: bool
    """Diffuse albedo is base (1 - F0)."""
    periodic: bool
    """Whether the maps tile seamlessly."""
    notes: tuple[str, ...]
    """What was guessed or not used, a sentence each."""
    files: Mapping[str, str]
    """File names by map."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.base.shape[1], self.base.shape[2]


def read_channels(folder: str | Path, *, normal: NormalStyle | None = None) -> SetChannels:
    """Read the maps in a folder, by their file names or by the sidecar of matcap's export.

    Args:
        normal: direction of the normal map's green where no name states it: "gl" up, "dx" down.

    Raises:
        MatcapError: no folder, no base colour in it, two files for one map, maps of different
            aspect ratios, a picture that cannot be read or used.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MatcapError.at(folder, "no such folder", "check the path")
    with tempfile.TemporaryDirectory(prefix="matcap-") as place:
        about = stated_export(folder, Path(place)) or assigned(folder)
        if "base" not in about.files:
            unused = f" (not used: {', '.join(about.left_out)})" if about.left_out else ""
            raise MatcapError.at(
                folder,
                f"there is no map of base colour in this folder{unused}",
                "name one ..._Color, ..._diff, ..._albedo or ..._basecolor",
            )
        return _Set(about, dict(about.files), left_out=[*about.left_out]).channels(normal)


@dataclass
class _Set:
    """A set while it is read; each file is opened once."""

    about: SetFiles
    """The files, and what is stated of them."""
    files: dict[str, NamedFile]
    """Files by map; unusable ones are removed."""
    left_out: list[str]
    """Files that are not used, with the reason."""
    notes: list[str] = field(default_factory=list)
    """As in SetChannels."""
    _opened: dict[Path, Pixels] = field(default_factory=dict)

    def channels(self, normal: NormalStyle | None) -> SetChannels:
        """All maps, with notes."""
        about = self.about
        self._leave_out_what_is_not_there()
        self._judge_height()
        sizes = [self._pixels(k).size for k in ("base", "normal", "height") if k in self.files]
        size = max(sizes, key=lambda one: one[0] * one[1])
        texel = 2.0 / size[0] if about.texel is None else about.texel
        scalars = {kind: self._scalar(kind, size) for kind in ("roughness", "gloss", "metallic")}
        height, whole = self._height(size)
        base = self._colour("base", size)
        assert base is not None
        roughness = self._roughness(scalars)
        specular = self._colour("specular", size)
        if specular is not None and about.f0 is not None:
            specular = np.minimum(specular * np.float32(about.f0), np.float32(1.0))
        level = self._scalar("specular level", size)
        slopes = self._slopes(size, height, texel, normal)
        # F0 with gloss in alpha is Unity's and glTF's, which use base (1 - F0).
        packed = "specular" in self.files and "gloss" in self.files["specular"].channels
        if self.left_out:
            self.notes.append(f"not used: {', '.join(self.left_out)}")
        return SetChannels(
            base=base,
            roughness=roughness,
            metallic=scalars["metallic"],
            specular=specular,
            level=level,
            dielectric=DIELECTRIC if about.f0 is None else about.f0,
            height=height,
            whole=whole,
            slopes=slopes,
            texel=texel,
            exact=about.texel is not None,
            conserving=about.conserving or packed,
            periodic=about.periodic,
            notes=tuple(self.notes),
            files={kind: file.path.name for kind, file in self.files.items()},
        )

    def _pixels(self, kind: str) -> Pixels:
        path = self.files[kind].path
        if path not in self._opened:
            self._opened[path] = _read(path, self.about.grid)
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

    def _colour(self, kind: str, size: tuple[int, int]) -> Array | None:
        """(3, H, W) linear Rec.709, clipped to [0, 1]."""
        if kind not in self.files:
            return None
        pixels = self._pixels(kind)
        colours, notes = linear_colours(pixels, light=self.files[kind].light)
        self.notes += [f"{pixels.path.name}: {note}" for note in notes]
        if "A" in pixels.roles and "A" not in self.files[kind].channels.values():
            opaque = float(pixels.channel("A").min()) >= 0.999
            if not opaque:
                self.notes.append(f"{pixels.path.name}: its transparency is not used")
        return self._fitted(self._clipped(np.moveaxis(colours, -1, 0), pixels), size, pixels)

    def _scalar(self, kind: str, size: tuple[int, int]) -> Array | None:
        """(1, H, W) of the map's channel, clipped to [0, 1]."""
        if kind not in self.files:
            return None
        pixels, role = self._pixels(kind), self.files[kind].channels[kind]
        self._note_colours(pixels, self.files[kind])
        return self._fitted(self._clipped(pixels.channel(role)[None], pixels), size, pixels)

    def _height(self, size: tuple[int, int]) -> tuple[Array | None, bool]:
        if "height" not in self.files:
            return None, False
        pixels, file = self._pixels("height"), self.files["height"]
        self._note_colours(pixels, file)
        height = self._fitted(pixels.channel(file.channels["height"])[None], size, pixels)
        if self.about.height is not None:
            scale, midlevel = self.about.height
            height = (height - np.float32(midlevel)) * np.float32(scale)
        return height, pixels.whole

    def _slopes(
        self, size: tuple[int, int], height: Array | None, texel: float, style: NormalStyle | None
    ) -> Array | None:
        if "normal" not in self.files:
            return None
        file, pixels = self.files["normal"], self._pixels("normal")
        raw_slopes, notes = slopes_of(pixels)
        self.notes += notes
        slopes = self._fitted(raw_slopes, size, pixels)
        if style is not None and file.style not in ("", style):
            self.notes.append(
                f"{file.path.name}: its name says {file.style}, so --normal {style} is not used"
            )
        named: NormalStyle | None = "gl" if file.style == "gl" else "dx" if file.style else style
        if named is None:
            rise = None if height is None else gradient(height, texel)
            named = style_of(slopes, rise, usual_style(self.files.values()))
            self.notes.append(
                f"{file.path.name} does not say which way green points: assumed +Y "
                f"{'up (gl)' if named == 'gl' else 'down (dx)'}; --normal sets it"
            )
        return (
            slopes if named == "gl" else slopes * np.array([1.0, -1.0], np.float32)[:, None, None]
        )

    def _roughness(self, scalars: Mapping[str, Array | None]) -> Array | None:
        if scalars["roughness"] is not None:
            if scalars["gloss"] is not None and self.files["gloss"].path not in (
                self.files[kind].path for kind in self.files if kind != "gloss"
            ):
                self.left_out.append(f"{self.files['gloss'].path.name} (roughness is taken)")
            return scalars["roughness"]
        return None if scalars["gloss"] is None else 1.0 - scalars["gloss"]

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

    def _fitted(self, values: Array, size: tuple[int, int], pixels: Pixels) -> Array:
        """(C, H, W) resampled to the set's (width, height): area mean down, bilinear up.

        Raises:
            MatcapError: another aspect ratio.
        """
        import cv2

        width, height = values.shape[2], values.shape[1]
        if (width, height) == size:
            return np.ascontiguousarray(values, dtype=np.float32)
        if min(width, height) > 1 and abs(width * size[1] / (height * size[0]) - 1.0) > _SHAPE:
            raise MatcapError.at(
                pixels.path,
                f"is {width} x {height} pixels, another aspect ratio than {size[0]} x {size[1]}, "
                "the largest map's",
                "give maps of the same extent",
            )
        way = cv2.INTER_AREA if width > size[0] else cv2.INTER_LINEAR
        resized = [cv2.resize(one, size, interpolation=way) for one in values.astype(np.float32)]
        return np.stack(resized)


def _read(path: Path, grid: tuple[int, int] | None) -> Pixels:
    """Read a picture, or all UDIM tiles of one, joined."""
    if grid is None or TOKEN not in path.name:
        return read_pixels(path)
    columns, _ = grid
    parts = [read_pixels(path.with_name(name)) for name in tile_names(path.name, grid)]
    lines = [parts[start : start + columns] for start in range(0, len(parts), columns)]
    first = lines[-1][0]
    if any(one.stored.shape != first.stored.shape for one in parts):
        raise MatcapError.at(path, "its tiles differ in size", "export the material again")
    rows = [np.concatenate([one.stored for one in line], axis=1) for line in lines]
    whole = np.concatenate(rows[::-1])
    return Pixels(first.path, whole, first.roles, first.primaries)

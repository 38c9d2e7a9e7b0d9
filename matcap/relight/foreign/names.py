"""Which file of a set is which map: by its name, or by the sidecar of an export of matcap."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import Any, Literal

from matcap.brdf.stated import SCALE
from matcap.errors import MatcapError
from matcap.files.names import name_fault, note
from matcap.files.settings import bounded

# Bricks066_1K-JPG_Color.jpg   _NormalGL  _Roughness  _Displacement  _Metalness    ambientCG
# rock_wall_08_diff_2k.jpg     _nor_gl    _rough      _disp          _arm          Poly Haven
# brushed-metal-albedo.png     -normal-ogl  -roughness  -height  -metallic  -ao    FreePBR
# T_Brick_BC.png               _N  _ORM                                            Unreal
# b_BaseMap.png                _MaskMap  _MetallicSmoothness  _Normal              Unity
# mat_metallicRoughness.png    _occlusionRoughnessMetallic  _specularGlossiness    glTF
#
# A name is split into words at separators and capitals. Words that all files of the folder begin or
# end with are dropped: the material's name, the resolution. Of the rest the last word that names a
# map decides; several in a row are a packed map (_channels). The vocabulary is that of the sources
# above, of Blender's Node Wrangler, and of Quixel, Substance, Textures.com and 3DTextures.

# Formats that are read; of two files of one map, the one with the earlier suffix.
READ_SUFFIXES = (
    ".exr", ".tif", ".tiff", ".tx", ".png", ".tga", ".bmp", ".webp", ".jpg", ".jpeg", ".jpe",
    ".jfif",
)  # fmt: skip
# Pictures that are not read, and noted.
_OTHER_SUFFIXES = (
    ".dds", ".ktx", ".ktx2", ".basis", ".psd", ".psb", ".xcf", ".kra", ".hdr", ".gif", ".jp2",
    ".jxl", ".avif", ".heic", ".svg", ".sbsar", ".pfm", ".rat",
)  # fmt: skip

USED = (
    "base", "normal", "roughness", "gloss", "metallic", "height", "specular", "specular level",
)  # fmt: skip
# Words that name each map, in lower case; of two files of one map, the one with the earlier word.
_WORDS: dict[str, tuple[str, ...]] = {
    "base": (
        "basecolor", "basecolour", "basemap", "base", "bc", "albedo", "alb", "maintex", "color",
        "colour", "col", "diffuse", "diff", "dif",
    ),
    "normal": ("normal", "normals", "nor", "nrm", "norm", "nrml", "nml"),
    "roughness": ("roughness", "rough", "rgh", "rou"),
    "gloss": ("glossiness", "gloss", "smoothness", "smooth", "gls"),
    "metallic": ("metallic", "metalness", "metal", "metallness", "mtl", "met"),
    "height": (
        "displacement", "displace", "disp", "dsp", "height", "heightmap", "hgt", "ht", "parallax",
        "bump", "bmp",
    ),
    "specular": ("specular", "spec", "spc", "f0", "reflection", "refl"),
    "specular level": ("specularlevel", "speclevel"),
    "ambient occlusion": ("ao", "occlusion", "occ", "ambientocclusion", "aoc"),
    "opacity": ("opacity", "alpha", "transparency", "cutout"),
    "bent normal": ("bent",),
    "cavity": ("cavity", "cav", "curvature", "curv", "edge", "edges", "convexity", "concavity"),
    "emission": ("emissive", "emission", "emit", "glow"),
    "mask": ("id", "mask", "masks", "matid"),
    "translucency": (
        "translucency", "transmission", "thickness", "subsurface", "sss", "scattering", "fuzz",
    ),
    "coating": ("clearcoat", "coat", "sheen", "anisotropy", "anisotropic", "ior"),
    "diffuse roughness": ("diffuseroughness",),
    "preview": ("preview", "thumb", "thumbnail", "render", "combined", "uv", "wireframe"),
}  # fmt: skip
_STYLES = {"gl": ("gl", "ogl", "opengl", "yup"), "dx": ("dx", "directx", "d3d", "ydown")}
# Qualifiers of a map's name that do not change which map it is.
_QUALIFIERS = (
    "map", "tex", "texture", "srgb", "linear", "lin", "raw", "noncolor", "data", "ambient", "mixed",
    "tangent", "pbr", "space", "world", "object", "ws", "os", "worldspace", "objectspace", "aces",
    "acescg", "utility",
)  # fmt: skip
_UDIM = re.compile(r"(?<!\d)1\d{3}(?!\d)")  # a tile's number in a name (1001 and up)
# Words that say that normals are not in tangent space.
_SPATIAL = frozenset(("world", "object", "ws", "os", "worldspace", "objectspace"))
OBJECT_SPACE = "normals of object or world space"
# Words before a map's that make it a map of another layer than the base.
_LAYERS = ("coating", "translucency", "emission")
# Colour spaces that Substance, ACES pipelines and people add to names, by their first word.
_SPACES = {
    "acescg": "lin_ap1", "ap1": "lin_ap1", "ap0": "lin_ap0", "2020": "lin_rec2020",
    "aces2065": "lin_ap0", "2065": "lin_ap0",
    "linear": "lin_rec709", "lin": "lin_rec709", "raw": "lin_rec709",
}  # fmt: skip
# Separate words that are one: names of OpenPBR and Arnold, and of maps packed by letters.
_ONE_WORD = re.compile(
    r"(?i)(?<![a-z])(diffuse|specular)[\s_\-.]+(roughness)(?![a-z])"
    r"|(?<![a-z])(ao|occ|occlusion)[\s_\-.]+(rough(?:ness)?|rgh)[\s_\-.]+(metal(?:lic|ness)?|met)(?![a-z])"
    r"|(?<![a-z])(ao|[orm])[\s_\-.]+(ao|[orm])[\s_\-.]+(ao|[orm])(?![a-z])"
)
_RESOLUTION = re.compile(r"\d+|\d+k|\d+x\d+|\d+px|jpe?g|png|exr|tiff?|tga|webp|lod\d|v\d+|bake\d*")
# Maps by a single letter at the end of a name, as in T_Brick_N.
_LETTERS = {
    "d": "base", "c": "base", "n": "normal", "r": "roughness", "g": "gloss", "m": "metallic",
    "h": "height", "s": "specular", "o": "ambient occlusion", "e": "emission",
}  # fmt: skip

_SCALAR_LETTERS = frozenset(("r", "m", "o", "ao"))

# Channel of a picture that holds a map, by map: "R", "G", "B", "A", or "RGB".
Packing = Mapping[str, str]
_LEVEL = {"a": "ambient occlusion", "o": "ambient occlusion", "r": "roughness", "m": "metallic"}
# Packed maps by their short names.
SHORT: dict[str, Packing] = {
    "maskmap": {"metallic": "R", "ambient occlusion": "G", "gloss": "A"},  # Unity HDRP
    "mads": {"metallic": "R", "ambient occlusion": "G", "gloss": "A"},
    "mods": {"metallic": "R", "ambient occlusion": "G", "gloss": "A"},
    "mohs": {"metallic": "R", "ambient occlusion": "G", "height": "B", "gloss": "A"},
    "ord": {"ambient occlusion": "R", "roughness": "G", "height": "B"},  # Quixel
    "ordp": {"ambient occlusion": "R", "roughness": "G", "height": "B"},
    **{
        "".join(letters): {_LEVEL[one[0]]: role for one, role in zip(letters, "RGB", strict=True)}
        for occlusion in ("a", "o", "ao")
        for letters in permutations((occlusion, "r", "m"))
    },
}
# Packed maps by the maps that their name lists: glTF 2.0, section 3.9.2; Unity.
_SPELLED: dict[tuple[str, ...], Packing] = {
    ("metallic", "roughness"): {"roughness": "G", "metallic": "B"},
    ("metallic", "gloss"): {"metallic": "R", "gloss": "A"},
    ("specular", "roughness"): {"roughness": "R"},  # Arnold's and OpenPBR's, of the base
    ("base", "opacity"): {"base": "RGB", "opacity": "A"},
    ("bent normal", "normal"): {"bent normal": "RGB"},
    ("base", "specular"): {"specular": "RGB"},  # specular colour, said the other way round
    ("specular", "base"): {"specular": "RGB"},
}
_COLOURS = ("base", "specular", "normal", "bent normal")
_SCALARS = (
    "roughness", "gloss", "metallic", "height", "ambient occlusion", "opacity", "cavity",
)  # fmt: skip
_KIND = {word: kind for kind, words in _WORDS.items() for word in words}
_STYLE = {word: style for style, words in _STYLES.items() for word in words}


@dataclass(frozen=True)
class NamedFile:
    """A file, and the maps that its name says it holds."""

    path: Path
    channels: Packing
    """Channels of each map; empty where the name names none."""
    style: str = ""
    """Direction of green that the name states: "gl" up, "dx" down, or ""."""
    rank: int = 0
    """Rank: of two files of the same map the one of lower rank is used."""
    stem: str = ""
    """The name without the words that name a map: the same for all files of a set."""
    diffuse: bool = False
    """The name calls a base colour diffuse."""
    space: str = ""
    """Colour space that the name states (space_of_name), before what the file does; or ""."""


@dataclass(frozen=True)
class SetFiles:
    """The files of a set, and what is stated of them: by the sidecar of matcap's export alone."""

    files: Mapping[str, NamedFile]
    """Files by map."""
    left_out: tuple[str, ...]
    """Files that are not used, each with the reason."""
    texel: float | None = None
    """A texel's side in plane units."""
    height: tuple[float, float] | None = None
    """(scale, midlevel): height in plane units = (value - midlevel) scale."""
    conserving: bool = False
    """Diffuse albedo is base (1 - F0)."""
    periodic: bool = True
    """Whether the maps tile seamlessly."""


@dataclass(frozen=True)
class _Word:
    """A word of a name, in lower case, and the index of the part between separators it is in."""

    text: str
    token: int

    @property
    def names(self) -> bool:
        """Whether it names a map or is a qualifier."""
        return self.text in _VOCABULARY


_VOCABULARY = frozenset((*_KIND, *_STYLE, *_QUALIFIERS, *SHORT))


def assigned(folder: Path) -> SetFiles:
    """Choose the file of each map in a folder.

    Raises:
        MatcapError: two files are the same map, of two materials or of two sizes.
    """
    # macOS writes ._NAME next to files on other file systems.
    paths = [p for p in sorted(folder.iterdir()) if not p.name.startswith(".") and p.is_file()]
    candidates = named([path for path in paths if path.suffix.lower() in READ_SUFFIXES])
    files: dict[str, NamedFile] = {}
    left_out = {
        path: "a kind of file that is not read"
        for path in paths
        if path.suffix.lower() in _OTHER_SUFFIXES
    }
    for file in sorted(candidates, key=_preference):
        wanted = [kind for kind in file.channels if kind in USED]
        taken = [kind for kind in wanted if kind in files]
        for kind in taken:
            if files[kind].stem != file.stem:
                both = files[kind].path.name, file.path.name
                tiles = all(_UDIM.search(name) for name in both)
                raise MatcapError.at(
                    folder,
                    f"{both[0]} and {both[1]} are "
                    + ("UDIM tiles" if tiles else f"both its {kind} map"),
                    "keep the maps of one tile in a folder, without the number"
                    if tiles
                    else "keep the maps of one set, in one size, in a folder",
                )
        files |= {kind: file for kind in wanted if kind not in files}
        if not wanted:
            left_out[file.path] = " and ".join(file.channels) or "its name names no map"
        elif len(taken) == len(wanted):
            left_out[file.path] = f"{files[taken[0]].path.name} is taken"
    return SetFiles(files, tuple(f"{path.name} ({why})" for path, why in sorted(left_out.items())))


def usual_style(files: Iterable[NamedFile]) -> Literal["gl", "dx"]:
    """Direction of green that a set's naming suggests: down for Unreal and Substance, else up.

    Unreal Engine names textures T_NAME. Substance Painter's default project is DirectX, its default
    texture set DefaultMaterial; its packed map is OcclusionRoughnessMetallic.
    """
    stems = [file.path.stem for file in files]
    down = ("T_", "DefaultMaterial")
    spelled = any(stem.endswith("OcclusionRoughnessMetallic") for stem in stems)
    return "dx" if spelled or any(stem.startswith(down) for stem in stems) else "gl"


def named(paths: Sequence[Path]) -> list[NamedFile]:
    """The maps that the names of a folder's pictures state, in order."""
    cut = [_words(path.stem) for path in paths]
    before, after = _shared(cut), _shared([words[::-1] for words in cut])
    files = [_named(path, words, before, after) for path, words in zip(paths, cut, strict=True)]
    if not any("base" in file.channels for file in files):
        # The shared words were a map's own: color.png and color_ao.png.
        files = [_named(path, words, (), ()) for path, words in zip(paths, cut, strict=True)]
    return files


def _preference(file: NamedFile) -> tuple[int, int, int, int, str]:
    """Sort key of files of the same map, best first: unpacked before packed, gl before dx."""
    maps = sum(kind in USED for kind in file.channels)
    suffix = READ_SUFFIXES.index(file.path.suffix.lower())
    return maps, ("gl", "", "dx").index(file.style), file.rank, suffix, file.path.name


def words_of(kind: str) -> tuple[str, ...]:
    """Words that name a map, in lower case."""
    return _WORDS.get(kind, ())


def _words(stem: str) -> tuple[_Word, ...]:
    stem = _ONE_WORD.sub(lambda match: "".join(part for part in match.groups() if part), stem)
    tokens = [token for token in re.split(r"[\s_\-.,()\[\]+#@]+", stem) if token]
    return tuple(_Word(text, place) for place, token in enumerate(tokens) for text in _cut(token))


def _cut(token: str) -> tuple[str, ...]:
    """Words of a token: of the vocabulary if it is composed of them, else split at capitals."""
    plain = token.lower()
    if plain in SHORT:
        return (plain,)
    parts = [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[^A-Z]+", token)]
    return _segmented(plain) or tuple(w for part in parts for w in _segmented(part) or (part,))


@cache
def _segmented(text: str) -> tuple[str, ...]:
    """The fewest words of the vocabulary whose concatenation is `text`; () if there are none."""
    best: list[tuple[str, ...] | None] = [()]
    for end in range(1, len(text) + 1):
        ways = [
            (*way, text[start:end])
            for start, way in enumerate(best)
            if way is not None and text[start:end] in _VOCABULARY
        ]
        best.append(min(ways, key=len, default=None))
    return best[-1] or ()


def _shared(cut: Sequence[Sequence[_Word]]) -> tuple[str, ...]:
    """Words that most names begin with.

    More than half of the files share the first word, at least 4/5 of those each further one: so a
    colour, normal_gl and normal_dx share none.
    """
    names = [tuple(word.text for word in words) for words in cut]
    least = len(names) if len(names) < 4 else max(3, len(names) // 2 + 1)
    common: tuple[str, ...] = ()
    while True:
        group = [
            name for name in names if name[: len(common)] == common and len(name) > len(common)
        ]
        following = Counter(name[len(common)] for name in group)
        word, count = max(following.items(), key=lambda one: one[1], default=("", 0))
        if count < max(2, least):
            return common
        common = (*common, word)
        least = max(2, len(names) if len(names) < 4 else count - count // 5)


def _named(
    path: Path, words: tuple[_Word, ...], before: tuple[str, ...], after: tuple[str, ...]
) -> NamedFile:
    """The maps that a name states, without the words `before` and `after` that all names share."""
    texts = tuple(word.text for word in words)
    first = len(before) if texts[: len(before)] == before else 0
    last = len(words) - (len(after) if texts[::-1][: len(after)] == after else 0)
    rest = list(words[first:last])
    while rest and _RESOLUTION.fullmatch(rest[-1].text):
        rest.pop()
    recognised = _recognised(rest, alone=first + len(rest) < 2)
    kinds = tuple(dict.fromkeys(kind for kind, _ in recognised if kind in _WORDS))
    styles = [kind for kind, _ in recognised if kind in _STYLES]
    short = next((SHORT[word.text] for _, word in recognised if word.text in SHORT), None)
    channels = short or _channels(kinds)
    recognised_texts = {word.text for _, word in recognised}
    if channels.get("normal") == "RGB" and _SPATIAL & recognised_texts:
        channels = {OBJECT_SPACE: "RGB"}
    rank = max((_rank(kind, word.text) for kind, word in recognised), default=0)
    used = {id(word) for _, word in recognised}
    stem = " ".join(word.text for word in words if id(word) not in used)
    style = styles[-1] if styles and "normal" in channels else ""
    diffuse = "base" in channels and bool({"diffuse", "diff", "dif"} & recognised_texts)
    space = _space([word.text for word in words], recognised) if "base" in channels else ""
    return NamedFile(path, channels, style, rank, stem, diffuse, space)


def _space(texts: Sequence[str], recognised: Sequence[tuple[str, _Word]]) -> str:
    """The colour space that the words at and after a map's state, or ""."""
    spoken = [word.text for _, word in recognised]
    first = len(texts) - texts[::-1].index(spoken[0]) - 1
    return next((_SPACES[text] for text in texts[first:] if text in _SPACES), "")


def _recognised(rest: Sequence[_Word], *, alone: bool) -> list[tuple[str, _Word]]:
    """The words at a name's end that state its map, each with the map or style it names.

    Args:
        alone: the name has no other words: a single letter then names no map.
    """
    if len(rest) > 1 and {rest[-1].text, rest[-2].text} <= _SCALAR_LETTERS:
        return []  # a packed map whose order nothing states
    if rest and rest[-1].text in _LETTERS and not alone:
        return [(_LETTERS[rest[-1].text], rest[-1])]
    end = len(rest)
    while end and not (rest[end - 1].text in _KIND or rest[end - 1].text in SHORT):
        end -= 1
    start = end
    while start and rest[start - 1].token == rest[end - 1].token and rest[start - 1].names:
        start -= 1  # the whole part between separators
    while start and _goes_with(rest[start - 1], rest[start:end]):
        start -= 1
    stop = end
    while stop < len(rest) and rest[stop].names:
        stop += 1
    return [(_KIND.get(w.text) or _STYLE.get(w.text, ""), w) for w in rest[start:stop]]


def _goes_with(word: _Word, following: Sequence[_Word]) -> bool:
    """Whether a word before a separator belongs to the map words after it.

    Abbreviations make no packed map: metal_rough is the roughness of a metal.
    """
    if word.text in _STYLE or word.text in _QUALIFIERS:
        return True
    kind = _KIND.get(word.text)
    kinds = tuple(dict.fromkeys(_KIND[w.text] for w in following if w.text in _KIND))
    if kind is None or not kinds:
        return False
    if kind in _LAYERS:
        return True
    if (word.text, following[0].text) in _PAIRS:
        return True
    if kind == kinds[0]:
        return (word.text, following[0].text) in (("base", "color"), ("base", "colour"))
    whole = all(w.text == _WORDS[_KIND[w.text]][0] or w.text in _LONG for w in following)
    whole = whole and (word.text == _WORDS[kind][0] or word.text in _LONG)
    return whole and (kind, *kinds) in _JOINED


# A colour and a scalar in alpha (Terrain3D).
_PAIRS = {("alb", "ht"), ("albedo", "height"), ("nrm", "rgh"), ("normal", "roughness")}
_LONG = ("occlusion", "smoothness", "bent", "normal", "specular", "color", "ao")
_JOINED = {
    ("metallic", "roughness"),
    ("metallic", "gloss"),
    ("roughness", "metallic"),
    ("ambient occlusion", "roughness", "metallic"),
    ("bent normal", "normal"),
    ("specular", "base"),
    ("specular", "gloss"),
}


def _channels(kinds: tuple[str, ...]) -> Packing:
    """Channels of the maps that a name lists; {} where no packing is known for them."""
    if len(kinds) > 1 and kinds[0] in _LAYERS:
        return {kinds[0]: "R"}
    if kinds in _SPELLED:
        return _SPELLED[kinds]
    if len(kinds) == 1:
        return {kinds[0]: "RGB" if kinds[0] in _COLOURS else "R"}
    if len(kinds) == 2 and kinds[0] in _COLOURS and kinds[1] in _SCALARS:
        return {kinds[0]: "RGB", kinds[1]: "A"}
    if len(kinds) in (3, 4) and all(kind in _SCALARS for kind in kinds):
        return dict(zip(kinds, "RGBA", strict=False))
    return {}


def _rank(kind: str, word: str) -> int:
    words = _WORDS.get(kind, ())
    return words.index(word) if word in words else len(words)


# Read exports of matcap by their sidecar, which states maps, units and encodings.

_FORMAT, _VERSION = "matcap export", 2
# Beginnings of a texture's `meaning` in the sidecar, and the maps that it holds.
_MEANINGS: tuple[tuple[str, Packing], ...] = (
    ("diffuse albedo", {"base": "RGB"}),
    ("base colour", {"base": "RGB"}),
    ("specular albedo F0", {"specular": "RGB"}),
    ("F0, on the sRGB curve", {"specular": "RGB"}),
    ("RGB: F0, on the sRGB curve, A: smoothness", {"specular": "RGB", "gloss": "A"}),
    ("F0 / 0.08 of the dielectric", {"specular level": "R"}),
    ("perceptual roughness", {"roughness": "R"}),
    ("roughness", {"roughness": "R"}),
    ("metallic", {"metallic": "R"}),
    ("R: occlusion, G: roughness, B: metallic", {"roughness": "G", "metallic": "B"}),
    ("R: metallic, G: occlusion, B: detail, A: smoothness", {"metallic": "R", "gloss": "A"}),
    ("RGB: metallic, A: smoothness", {"metallic": "R", "gloss": "A"}),
    ("unit normal", {"normal": "RGB"}),
    ("height", {"height": "R"}),
)
# Targets whose shader uses base (1 - F0) where F0 is a texture of its own.
_CONSERVING = ("unity-hdrp", "unity-urp", "usd")


def stated_export(folder: Path) -> SetFiles | None:
    """Read the sidecar in a folder; None where there is none.

    Raises:
        MatcapError: several exports, a damaged sidecar, or textures inside of a .glb.
    """
    sidecars = [(file, about) for file in sorted(folder.glob("*.json")) if (about := _read(file))]
    if not sidecars:
        return None
    if len(sidecars) > 1:
        raise MatcapError.at(
            folder,
            f"there are {len(sidecars)} exports in this folder",
            "keep one export in a folder",
        )
    file, about = sidecars[0]
    if about.get("target") == "gltf":
        raise MatcapError.at(
            folder, "the textures of this export are inside its .glb", "give the map set it is of"
        )
    try:
        return _stated(folder, about)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OSError) as error:
        raise MatcapError.at(
            file,
            f"the export's description is damaged ({error})",
            "export the material again, or remove this file to go by the textures' names",
        ) from error


def _read(file: Path) -> dict[str, Any] | None:
    """A sidecar's JSON; None where a file is something else.

    Raises:
        MatcapError: a sidecar of another version.
    """
    try:
        about = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        note(f"{file}: not readable as JSON, so no export's units and names are taken from it")
        return None
    if not isinstance(about, dict) or about.get("format") != _FORMAT:
        return None
    if about.get("version") != _VERSION:
        raise MatcapError.at(
            file,
            f"export of version {about.get('version')}, this matcap reads {_VERSION}",
            "export it again with this matcap, or remove this file",
        )
    return about


def _stated(folder: Path, about: Mapping[str, Any]) -> SetFiles:
    unit = 1.0
    if about["unit"] == "mm":
        unit = bounded(about["provenance"][SCALE], f"'{SCALE}'", 1e-9, 1e9)
    named = [_stated_file(folder, name, entry) for name, entry in about["files"].items()]
    files: dict[str, NamedFile] = {}
    left_out = []
    # Prefer +Y normals to -Y ones, and the maps themselves to colours made for one shader.
    for one in sorted(named, key=lambda one: (one.style == "dx", one.rank)):
        taken = [kind for kind in one.channels if kind not in files]
        files |= {kind: one for kind in taken}
        if not taken:
            left_out.append(f"{one.path.name} (no map of its own)")
    code = about.get("height_code")
    height = None
    if "height" in files and code is not None:
        height = (
            bounded(code["scale"], "the height's scale", 0.0, 1e9) / unit,
            bounded(code["midlevel"], "the height's midlevel", -1e9, 1e9),
        )
    texel = bounded(about["texel"], "'texel'", 1e-9, 1e9) / unit
    target = str(about["target"]).removesuffix("-specular")  # the specular workflow of an engine
    conserving = target in _CONSERVING and "specular" in files
    periodic = about["periodic"] is True
    return SetFiles(files, tuple(left_out), texel, height, conserving, periodic)


def _stated_file(folder: Path, name: str, entry: Mapping[str, str]) -> NamedFile:
    meaning = entry["meaning"]
    wrong = name_fault(name)
    if wrong:
        raise ValueError(f"the file {name!r} {wrong}")
    fits = [
        packing
        for start, packing in _MEANINGS
        if meaning == start or meaning.startswith((f"{start},", f"{start} ", f"{start};"))
    ]
    channels = fits[0] if fits else {}
    style = "dx" if "-Y" in meaning or "+Y down" in meaning else "gl"
    rank = 0 if meaning.startswith(("diffuse albedo", "specular albedo")) else 1
    style = style if "normal" in channels else ""
    space = "lin_rec709" if entry["colour_space"] == "linear" else ""
    return NamedFile(folder / name, channels, style, rank, space=space)

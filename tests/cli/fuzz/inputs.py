"""Small good files of every kind that matcap reads but pictures, and ways to spoil them."""

import hashlib
import json
import random
import re
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from PIL import Image

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.field.material import Material
from matcap.files.names import DIGEST, METHOD, digest_prefix
from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import DecoderConfig
from matcap.statistics.lattice import Wave

sys.path.insert(0, str(Path(__file__).parents[2]))
from materials import a_material
from random_maps import random_maps

SCENE = """
[film]
width = 64
height = 48
exposure = 1.5
[camera]
type = "perspective"
position = [0.0, -2.0, 2.0]
target = [0.0, 0.0, 0.0]
fov = 40.0
[surface]
type = "plane"
size = 2.0
[[light]]
type = "point"
position = [1.0, 1.0, 2.0]
intensity = [10.0, 9.0, 8.0]
[[light]]
type = "directional"
direction = [0.0, 0.5, 1.0]
irradiance = 1.0
"""
SETTINGS = """
# beside a shoot
preset = "draft"
detail = 512
size = "256x128"
time = "90s"
fov = 60.5
png = true
group = "time"
gap = 5
"""
_NASTY = (
    "0", "-1", "1e400", "-1e308", "nan", "inf", "99999999999999999999", "4294967295", "true",
    "[]", "{}", '""', '"\\u0000"', '"../../x"', "[[[[[[[[1]]]]]]]]", "1979-05-27", '"é"', "null",
    "[1, 2, 3, 4, 5, 6, 7, 8, 9]", "2147483648", "0.0000001", '"' + "x" * 5000 + '"',
)  # fmt: skip
_WORDS = re.compile(rb'"[^"\n]*"|-?\d+\.?\d*(?:[eE][-+]?\d+)?|true|false|\w+')
_NUMBERS = (0, 1, 2, 255, 256, 32767, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**24)


def write_inputs(folder: Path) -> dict[str, list[Path]]:
    """Good files by the kind of reader that they are for."""
    folder.mkdir(parents=True, exist_ok=True)
    colour = np.random.default_rng(3).integers(0, 256, (32, 32, 3), np.uint8)
    (folder / "scene.toml").write_text(SCENE)
    (folder / "matcap.toml").write_text(SETTINGS)
    write_material(folder / "small.matcap")
    write_example(folder / "example.matcap")
    write_mapset(random_maps(16, 16, low=0.1, high=0.6), folder / "set", MapSetInfo("set"))
    foreign = _write_foreign(folder, colour)
    (folder / "record.json").write_text(
        json.dumps({"format": "matcap batch record", "version": 1, "identity": "i",
                    "files": {"a": 1}, "seconds": 3.0, "steps": 4})
    )  # fmt: skip
    return {
        "foreign": foreign,
        "material": [folder / "small.matcap", folder / "example.matcap"],
        "mapset": [folder / "set" / "set.json"],
        "scene": [folder / "scene.toml"],
        "settings": [folder / "matcap.toml"],
        "record": [folder / "record.json"],
    }


def _write_foreign(folder: Path, colour: np.ndarray) -> list[Path]:
    """A set of others with a file of every kind, and one of matcap's exports."""
    from matcap.export.job import ExportJob
    from matcap.export.targets import write_export

    place = folder / "foreign"
    place.mkdir()
    grey, normal = colour[..., 1], np.full_like(colour, 128) + colour // 8
    normal[..., 2] = 250
    layer = np.dstack([colour, grey])
    Image.fromarray(layer).save(place / "w_AlbedoTransparency.png")
    Image.fromarray(normal).save(place / "w_Normal.tga")
    Image.fromarray(layer).save(place / "w_MaskMap.tif")
    Image.fromarray(colour).save(place / "w_AO.webp")
    oiio.ImageBuf(np.float32(colour / 255.0)).write(str(place / "w_Displacement.exr"), "half")
    Image.fromarray(grey).save(place / "w_Roughness.jpg")
    maps = random_maps(16, 16, low=0.1, high=0.6)
    write_export(ExportJob(maps, "out"), "unity-urp", folder / "exported")
    return sorted(place.iterdir()) + sorted((folder / "exported").iterdir())


def write_material(path: Path) -> None:
    """An untrained material of a few kilobytes."""
    shape = DecoderConfig(noise_channels=2, widths=(4, 4, 4, 4, 4), convolutions=(1, 1), cells=2)
    a_material("small", 0, shape, (Wave(0.1, 0.02),), across=1000).save(path)


def write_example(path: Path) -> None:
    """A material by example, of a piece of 64 x 48 texels."""
    maps = np.random.default_rng(1).random((6, 48, 64), np.float32)
    piece = Exemplar(
        maps[:3], maps[3:4], maps[4:5], 0.01 * maps[5:], np.ones((4, 48, 64), np.float32), 0.002
    )
    Material("example", {"example": Example.of(piece)}, 0.002, FlashSetup()).save(path)


def spoil(data: bytes, kind: str, others: list[bytes], chance: random.Random) -> bytes:
    """One to three random things done to a file."""
    ways: list[Callable[[bytes], bytes]] = [
        lambda d: _flip(d, chance),
        lambda d: _number(d, chance),
        lambda d: _cut(d, chance),
        lambda d: _move(d, chance),
        lambda d: _join(d, chance.choice(others), chance),
        lambda d: _fill(d, chance),
    ]
    if kind in ("scene", "settings", "mapset", "record") or data[:1] == b"{":
        ways = [lambda d: _reword(d, chance)] * 8 + ways
    if kind == "material":
        ways = [lambda d: _redescribe(d, chance)] * 6 + ways
    # Most of what matters stands at the beginning of a picture.
    if kind == "foreign":
        ways += [lambda d: _number(d[:2048], chance) + d[2048:]] * 4
        ways += [lambda d: _flip(d[:1024], chance) + d[1024:]] * 2
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        data = chance.choice(ways)(data)
    return data


def _flip(data: bytes, chance: random.Random) -> bytes:
    spoilt = bytearray(data)
    for _ in range(chance.choice((1, 2, 8, 64))):
        if spoilt:
            spoilt[chance.randrange(len(spoilt))] ^= 1 << chance.randrange(8)
    return bytes(spoilt)


def _number(data: bytes, chance: random.Random) -> bytes:
    form = chance.choice(("<H", ">H", "<I", ">I", "<Q", "B"))
    number = chance.choice(_NUMBERS) & ((1 << (8 * struct.calcsize(form))) - 1)
    place = chance.randrange(max(1, len(data) - struct.calcsize(form)))
    return data[:place] + struct.pack(form, number) + data[place + struct.calcsize(form) :]


def _cut(data: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(len(data) + 1)]


def _move(data: bytes, chance: random.Random) -> bytes:
    """A piece is lost, or comes twice."""
    one, other = sorted(chance.randrange(len(data) + 1) for _ in range(2))
    other = min(other, one + 4096)
    return data[:one] + data[other:] if chance.random() < 0.5 else data[:other] + data[one:]


def _join(data: bytes, other: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(len(data) + 1)] + other[chance.randrange(len(other) + 1) :]


def _fill(data: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(data) + 1)
    length = chance.choice((1, 4, 64, 1024))
    return data[:place] + bytes([chance.choice((0, 255))]) * length + data[place + length :]


def _reword(data: bytes, chance: random.Random) -> bytes:
    found = list(_WORDS.finditer(data))
    if not found:
        return data
    word = chance.choice(found)
    new = chance.choice((*_NASTY, chance.choice(found)[0].decode("utf-8", "replace")))
    return data[: word.start()] + new.encode() + data[word.end() :]


def _redescribe(data: bytes, chance: random.Random) -> bytes:
    """A .matcap whose container is right and whose description, shapes or names are not."""
    try:
        (length,) = struct.unpack("<Q", data[:8])
        header = json.loads(data[8 : 8 + length])
        if chance.random() < 0.6:
            about = json.loads(header["__metadata__"]["matcap"])
            header["__metadata__"]["matcap"] = json.dumps(_changed(about, chance))
        else:
            header = _changed(header, chance)
        header = forged(header, data[8 + length :])
        text = json.dumps(header).encode()
    except (ValueError, KeyError, TypeError, struct.error, RecursionError):
        return _flip(data, chance)
    return struct.pack("<Q", len(text)) + text + data[8 + length :]


def forged(header: dict[str, object], content: bytes) -> dict[str, object]:
    """The header with a digest that is right, as a stranger can make one."""
    result = header.get("__metadata__") if isinstance(header, dict) else None
    if not isinstance(result, dict) or not all(isinstance(one, str) for one in result.values()):
        return header
    digest = hashlib.new(METHOD, digest_prefix(result))
    digest.update(content)
    return {**header, "__metadata__": {**result, DIGEST: digest.hexdigest()}}


def _changed(value: object, chance: random.Random) -> object:
    """The same tree with one leaf, or one branch, replaced by something nasty."""
    if isinstance(value, dict) and value and chance.random() < 0.9:
        key = chance.choice(sorted(value))
        if chance.random() < 0.1:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: _changed(value[key], chance)}
    if isinstance(value, list) and value and chance.random() < 0.8:
        place = chance.randrange(len(value))
        return [*value[:place], _changed(value[place], chance), *value[place + 1 :]]
    return chance.choice(
        (0, -1, 1, 10**30, 1e308, float("nan"), float("inf"), None, True, "", "../../x", "\0", [],
         {}, [1] * 100, 4096, 1024, [[[[]]]], "x" * 5000, 0.5, 2**63)
    )  # fmt: skip

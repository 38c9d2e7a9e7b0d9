"""Mutates small valid files and reads them: python tests/photo/fuzz_readers.py [READER] [N] [SEED].

Only MatcapError may come out, and no picture with values that are not finite. One target a reader;
without a READER all of them. A mutation that fails is kept in the current folder.
"""

import random
import struct
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenEXR
import tifffile
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))
from simulated.files import gain_map, mosaic, opcode_list, write_dng

from matcap.errors import MatcapError
from matcap.files.pixels import linear_colours, read_mask, read_pixels
from matcap.photo.load import load_photo
from matcap.relight.environment_map import read_picture

Read = Callable[[Path], np.ndarray]
_EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)


@dataclass(frozen=True)
class Target:
    """A reader, and a valid file for it."""

    name: str
    make: Callable[[Path], object]
    read: Read


def light() -> np.ndarray:
    y, x = np.mgrid[0:72, 0:96]
    ramp = 0.1 + 0.6 * x / 95 * (0.6 + 0.4 * y / 71)
    return np.stack([ramp, 0.8 * ramp, 0.5 * ramp + 0.1], axis=-1)


def codes() -> np.ndarray:
    return np.rint(255 * light()).astype(np.uint8)


def photo(path: Path) -> np.ndarray:
    return load_photo(path).pixels


def colours(path: Path) -> np.ndarray:
    return linear_colours(read_pixels(path))[0]


def image(path: Path, **options: object) -> None:
    tags = Image.Exif()
    tags[274] = 6
    tags.get_ifd(0x8769)[0xA405] = 28
    Image.fromarray(codes()).save(path, exif=tags, **options)


def exr(path: Path) -> None:
    """Two parts, one of two layers."""
    planes = {c: light()[..., i].astype(np.float32) for i, c in enumerate("RGB")}
    layers = planes | {f"View.AO.{c}": plane for c, plane in planes.items()}
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    parts = [
        OpenEXR.Part(header | {"name": "depth"}, {"Z": planes["R"]}),
        OpenEXR.Part(header | {"name": "beauty", "colorInteropID": "lin_ap1_scene"}, layers),
    ]
    OpenEXR.File(parts).write(str(path))


def environment(path: Path) -> None:
    planes = {c: np.full((16, 32), 0.5, np.float32) for c in "RGB"}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(path))


def radiance(path: Path) -> None:
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n-Y 72 +X 96\n"
    path.write_bytes(head + bytes((128, 100, 64, 129)) * (72 * 96))


def tiff(path: Path) -> None:
    with tifffile.TiffWriter(path) as file:
        file.write(np.zeros((8, 8), np.uint8), photometric="minisblack", subfiletype=1)
        file.write((257 * codes()[..., 0].astype(np.uint16)), photometric="miniswhite")


def dng(path: Path) -> None:
    """Interleaved, with black levels by place, an odd active area, a crop and a gain map."""
    more = [
        (50713, 3, 2, (2, 2), True), (50714, 3, 4, (60, 64, 68, 200), True),
        (50719, 4, 2, (4, 2), True), (50720, 4, 2, (84, 66), True),
        (50975, 3, 1, 2, True), (41989, 3, 1, 28, True),
    ]  # fmt: skip
    size = (71, 95)
    opcodes = opcode_list(gain_map(np.full((2, 2, 1), 1.1), size))
    write_dng(
        path, mosaic(light()), more=more, black=None, active_area=(1, 1, 72, 96), opcodes2=opcodes
    )


TARGETS = [
    Target("JPEG", lambda path: image(path, format="JPEG"), photo),
    Target("PNG", lambda path: image(path, format="PNG"), photo),
    Target("WebP", lambda path: image(path, format="WEBP"), photo),
    Target("TIFF", tiff, photo),
    Target(
        "float TIFF",
        lambda path: tifffile.imwrite(path, light().astype(np.float32), photometric="rgb"),
        photo,
    ),
    Target("EXR", exr, photo),
    Target("Radiance HDR", radiance, photo),
    Target("DNG", dng, photo),
    Target("plain DNG", lambda path: write_dng(path, mosaic(light())), photo),
    Target(
        "float DNG",
        lambda path: write_dng(path, light().astype(np.float32), black=0, white=1),
        photo,
    ),
    Target("map, EXR", exr, colours),
    Target("map, TIFF", tiff, colours),
    Target("map, JPEG", lambda path: image(path, format="JPEG"), colours),
    Target("mask", tiff, read_mask),
    Target("environment", environment, read_picture),
    Target("environment, HDR", radiance, read_picture),
]
if find_spec("pillow_heif"):
    import pillow_heif

    TARGETS.append(
        Target("HEIC", lambda path: pillow_heif.from_pillow(Image.fromarray(codes())).save(path),
               photo)
    )  # fmt: skip


def mutated(data: bytes, chance: random.Random) -> bytes:
    """One to four changes: bits, numbers, cuts, repeats; mostly in the first and last bytes."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        size = len(changed)
        ends = chance.choice((min(size, 512), size, size))
        at = chance.randrange(ends) if chance.random() < 0.8 else size - 1 - chance.randrange(ends)
        kind = chance.randrange(6)
        if kind == 0:
            changed[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            changed[at] = chance.randrange(256)
        elif kind == 2 and at + 4 <= size:
            number = chance.choice(_EXTREMES)
            form = chance.choice(("<I", ">I"))
            changed[at : at + 4] = struct.pack(form, number)
        elif kind == 3 and at + 2 <= size:
            form = chance.choice(("<H", ">H"))
            changed[at : at + 2] = struct.pack(form, chance.choice(_EXTREMES) & 0xFFFF)
        elif kind == 4 and at > 16:
            del changed[at : at + chance.randint(1, 64)]
        else:
            changed[at:at] = changed[at : at + chance.randint(1, 64)]
        if not changed:
            return data[:16]
    return bytes(changed)


def faults(target: Target, count: int, seed: int, folder: Path) -> list[tuple[bytes, str]]:
    """(file, what came out) of the mutations that are not handled."""
    path = folder / "a.bin"
    target.make(path.with_suffix(".heic") if target.name == "HEIC" else path)
    if target.name == "HEIC":
        path.with_suffix(".heic").rename(path)
    whole = path.read_bytes()
    chance = random.Random(f"{target.name} {seed}")
    wrong = []
    for _ in range(count):
        data = mutated(whole, chance)
        path.write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                picture = target.read(path)
        except MatcapError as error:
            said = str(error)
            if "\n" not in said:
                continue
            wrong.append((data, f"more than one line: {said!r}"))
        except Exception as error:  # what is looked for
            wrong.append((data, f"{type(error).__name__}: {error}"))
        else:
            if not np.isfinite(picture).all():
                wrong.append((data, "a picture that is not finite"))
    return wrong


def main() -> None:
    """Run the targets that are asked for."""
    name, count, seed = [*sys.argv[1:], "", "", ""][:3]
    for target in TARGETS:
        if name in ("", target.name):
            with tempfile.TemporaryDirectory() as place:
                wrong = faults(target, int(count or 5000), int(seed or 0), Path(place))
            print(f"{target.name}: {len(wrong)} faults", flush=True)
            for number, (data, said) in enumerate(wrong[:5]):
                print("   ", said[:300])
                Path(f"fault_{target.name}_{number}.bin".replace(" ", "_")).write_bytes(data)


if __name__ == "__main__":
    main()

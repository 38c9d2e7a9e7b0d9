"""Every command that README's guide shows, run as it stands there: `python tests/docs/guide.py`.

Pages are run one by one, each in a folder with what its lines ask for, as quickly as their options
allow (QUICK). A line must answer with 0 and leave what it names with -o. Pages can be named;
test_guide.py runs some.
"""

import os
import re
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "guide"
# What makes a line quick, by its first word; the last of an option's values counts.
QUICK: dict[str, tuple[str, ...]] = {
    "capture": ("--preset", "instant", "--detail", "160", "--size", "64"),
    "batch": ("--preset", "instant", "--detail", "160", "--size", "64", "-j", "1"),
    "relight": ("--size", "160x120"),
    "export": ("--size", "64"),
    "view": ("--tile", "64"),
}
# Options that stand for hours, and what stands for them here.
SHORTER = {"16384": "512", "4096x256": "512x64", "2048": "512", "2048x256": "256x64", "200": "2"}


@cache
def anchors(page: Path) -> frozenset[str]:
    """The anchors that a page's headings make."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return frozenset(re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings)


def commands(page: Path) -> list[str]:
    """Lines of shell blocks, and of indented ones, that begin with matcap."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"```(?:sh|console|bash)\n(.*?)```", text, re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    lines += [line[4:] for line in text.splitlines() if line.startswith("    matcap ")]
    # Two spaces and a word are a remark beside the command.
    kept = [re.split(r"\s{2,}(?=\S)|\s+[#>]", line)[0].strip() for line in lines]
    return [line.removeprefix("$ ") for line in kept if re.match(r"(\$ )?matcap [a-z]", line)]


def lines_of(page: str) -> list[str]:
    """The lines of a page's shell blocks that are run here."""
    shown = commands(GUIDE / page)
    # Without --html it is a server, which nobody closes.
    return [line for line in shown if not line.startswith("matcap view") or "--html" in line]


def pages() -> list[str]:
    """Those with a line to run."""
    return sorted(page.name for page in GUIDE.glob("*.md") if lines_of(page.name))


def words_of(line: str) -> list[str]:
    """A line's words behind `matcap`, quick."""
    words = [SHORTER.get(word, word) for word in shlex.split(line)[1:]]
    quick = () if "--tile" in words else QUICK.get(words[0], ())
    # A target is told in what the photograph's own windows differ by, which takes several.
    quick += ("--detail", "512") * ("--target" in words)
    spread = (sorted(map(str, Path().glob(word))) if "*" in word else [word] for word in words)
    return [*(word for several in spread for word in several), *quick]


def prepare(folder: Path, page: str, captured: Path | None = None) -> None:
    """What the lines of a page read; `captured` has captures made before."""
    from matcap.cli.main import main

    photos = ROOT / "examples" / "photos"
    shutil.copytree(ROOT / "examples", folder / "examples")
    (folder / "photos").mkdir()
    for name, photo in (
        ("leather.dng", "leather.dng"), ("cloth.jpg", "tile.jpg"), ("photo.jpg", "tile.jpg"),
        ("photos/a.dng", "leather.dng"),
    ):  # fmt: skip
        shutil.copy(photos / photo, folder / name)
    shutil.copy(ROOT / "examples" / "scenes" / "flash.toml", folder / "scene.toml")
    text = " ".join(lines_of(page))
    if "out/" in text or "MATERIAL" in text:
        if captured:
            shutil.copytree(captured, folder / "out")
        else:
            words = ("capture", "leather.dng", "cloth.jpg", "-o", "out")
            assert main([*words, *QUICK["capture"]]) == 0
        shutil.copy(folder / "out" / "leather" / "leather.matcap", folder / "MATERIAL.matcap")
    if "bricks/" in text:
        _foreign(folder / "bricks")
    if "mask.png" in text:
        _mask(folder / "mask.png")
    if "oak_1" in text:
        _several(folder)


def _foreign(folder: Path) -> None:
    import cv2
    import numpy as np

    folder.mkdir()
    flat = np.full((64, 64, 3), 128, np.uint8)
    normal = flat.copy()
    normal[..., 0] = 255
    for name, picture in (("Color", flat), ("NormalGL", normal), ("Roughness", flat)):
        cv2.imwrite(str(folder / f"Bricks_{name}.png"), picture)


def _mask(path: Path) -> None:
    import cv2
    import numpy as np

    cv2.imwrite(str(path), np.tile(np.linspace(0, 255, 64, dtype=np.uint8), (64, 1)))


def _several(folder: Path) -> None:
    from simulated.files import write_shot
    from simulated.materials import piece
    from simulated.photographs import Hand, PhoneCamera, hold, take_several

    phone, hand = PhoneCamera(width=800, height=600), Hand()
    cameras = hold(phone, hand, 5, 11)
    shots = take_several(piece("leather"), phone, cameras, hand, 11)
    for number, shot in enumerate(shots, 1):
        write_shot(folder / f"oak_{number}.dng", shot, number)


def run(page: str, folder: Path, captured: Path | None = None) -> Iterator[tuple[str, str]]:
    """Run a page's lines in a folder: each line, and what is wrong with it, or "" (see prepare)."""
    from matcap.cli.main import main

    before = Path.cwd()
    os.chdir(folder)
    try:
        prepare(folder, page, captured)
        for line in lines_of(page):
            words = words_of(line)
            code = main([*words, *_again(words)])
            wrong = f"exit code {code}" if code else ""
            yield line, wrong or _missing(words)
    finally:
        os.chdir(before)


def _again(words: Sequence[str]) -> tuple[str, ...]:
    """Pages show one command with several options in turn, and all write to one place."""
    repeats = words[0] in ("capture", "synth", "export", "relight", "view", "blend", "sample")
    return ("--overwrite",) if repeats and "--overwrite" not in words else ()


def _missing(words: Sequence[str]) -> str:
    """What a line says that it writes and has not."""
    outputs = [Path(words[words.index(name) + 1]) for name in ("-o", "--html") if name in words]
    missing = [str(out) for out in outputs if not out.exists()]
    page = outputs[-1].read_text(encoding="utf-8") if "--html" in words and not missing else ""
    if page and not re.search(r'"photo": ?"data:image/jpeg', page):
        missing.append("the photograph in the page")
    return f"{', '.join(missing)} is not there" if missing else ""


def main_of(chosen: Sequence[str]) -> int:
    """Run pages, all by default; gives the number of lines at fault."""
    wrong = 0
    for page in chosen or pages():
        with tempfile.TemporaryDirectory(prefix="matcap-guide-") as folder:
            began = time.monotonic()
            for line, fault in run(page, Path(folder)):
                print(
                    f"{page}, {time.monotonic() - began:.0f} s: {line}: {fault or 'good'}",
                    flush=True,
                )
                wrong += bool(fault)
    print(f"{wrong} lines at fault")
    return wrong


if __name__ == "__main__":
    sys.exit(min(main_of(sys.argv[1:]), 1))

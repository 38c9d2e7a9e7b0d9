"""Puts deliberate faults into a copy of the package, and shows that the tests catch each.

    python tests/faults.py            all of them
    python tests/faults.py area plan  those whose names hold one of these words

A fault is one piece of text replaced in one file; it is caught when one of the tests named with it
fails. First the tests must pass as they are. test_faults.py runs a shorter form.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
_BOUNDS = "tests/relight/test_relight_bounds.py"
_EDGES = "tests/relight/test_relight_edges.py"
_PUBLISHING = "tests/files/test_publishing.py"


@dataclass(frozen=True)
class Fault:
    """One.

    Attributes:
        name: what is wrong.
        file: below the package's folder.
        right, wrong: text, and what it is replaced by.
        tests: that should fail, as pytest names them; the last may be -k with an expression.
    """

    name: str
    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]


def bounds(effect: str) -> tuple[str, ...]:
    """The tests of an effect's bound."""
    return _BOUNDS, "-k", f"{effect} or adds_up"


def effect_fault(effect: str, name: str, right: str, wrong: str, file: str = "") -> Fault:
    """A fault in a bound."""
    file = f"relight/{file or f'effects/{effect}.py'}"
    return Fault(f"{effect} bound: {name}", file, right, wrong, bounds(effect))


FAULTS = (
    effect_fault("specular", "glossy a hundredth", "/ (2.0 * math.pi *", "/ (200.0 * math.pi *",
                 "facts.py"),
    effect_fault("specular", "alpha squared for cubed", "self.alpha[0] ** 3", "self.alpha[0] ** 2",
                 "facts.py"),
    effect_fault("specular", "Fresnel's F0 alone", "return self.specular + (1.0 - self.specular)",
                 "return self.specular + 0.0 * (1.0 - self.specular)", "facts.py"),
    effect_fault("specular", "surroundings forgotten", "direct + environment.mirrored_bound(facts)",
                 "direct", "effects/direct.py"),
    effect_fault("diffuse", "surroundings forgotten", "+ facts.diffuse * facts.sky", "",
                 "effects/direct.py"),
    effect_fault("diffuse", "half", "facts.lambert * light +", "0.5 * facts.lambert * light +",
                 "effects/direct.py"),
    effect_fault("falloff", "a tenth", "light.varying * (facts.lambert",
                 "0.1 * light.varying * (facts.lambert", "effects/direct.py"),
    effect_fault("falloff", "nearer lights forgotten", "max(received - intensity / central**2",
                 "max(0.0 * received - intensity / central**2", "facts.py"),
    effect_fault("area", "a hundredth", "return Bound(total,", "return Bound(0.01 * total,"),
    effect_fault("area", "no light has a size", "if light.half_angle > 0.0", "if False"),
    effect_fault("environment", "a tenth", "facts.sky_varying * both +",
                 "0.1 * facts.sky_varying * both +"),
    effect_fault("environment", "tilt forgotten", "tilt = 1.0 if", "tilt = 0.0 if"),
    effect_fault("filtering", "a tenth", "Bound(facts.everything", "Bound(0.1 * facts.everything"),
    effect_fault("parallax", "a tenth", "Bound(facts.everything", "Bound(0.1 * facts.everything"),
    effect_fault("shadows", "only the lowest light's tenth", "Bound(sum(", "Bound(0.1 * sum("),
    effect_fault("shadows", "no light is low", "light.tangent < slope", "light.tangent < 0.0"),
    effect_fault("visibility", "nothing", "Bound(facts.surroundings",
                 "Bound(0 * facts.surroundings"),
    effect_fault("interreflection", "a twentieth", "Bound(facts.lambert**2",
                 "Bound(0.05 * facts.lambert**2"),
    effect_fault("multiscatter", "lights forgotten", "lobe / math.pi * light", "0.0 * light"),
    effect_fault("multiscatter", "surroundings forgotten", "share * facts.sky", "0.0 * facts.sky"),
    Fault("plan: bounds do not add up", "relight/plan.py",
          "            left -= bounds[effect].radiance\n", "", (_BOUNDS, "-k", "adds_up")),
    Fault("plan: largest first", "relight/plan.py", "key=lambda name: bounds[name].radiance",
          "key=lambda name: -bounds[name].radiance", (_BOUNDS, "-k", "adds_up")),
    Fault("publishing: files are not synced", "files/publish.py", "os.fsync(handle)", "pass",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: no order", "files/publish.py", "(name.endswith(\".json\"), name)",
          "(not name.endswith(\".json\"), name)", (_PUBLISHING, "-k", "last")),
    Fault("publishing: no roll-back", "files/publish.py",
          "    except BaseException:\n        _mend(folder)\n        raise",
          "    except BaseException:\n        raise",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: folders are not refused", "files/publish.py", "if path.is_dir() and",
          "if False and", (_PUBLISHING, "-k", "refused")),
    Fault("publishing: what is replaced stays", "files/publish.py",
          "for name in set(old) - set(fresh):", "for name in ():",
          ("tests/files/test_staging.py", "-k", "replaced_files")),
    Fault("publishing: the list goes first", "files/publish.py",
          "        for name in fresh:\n            os.replace(stage / name, folder / name)",
          "        os.unlink(folder / JOURNAL / _LIST)\n        for name in fresh:\n"
          "            os.replace(stage / name, folder / name)",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: the folder is not synced before the list goes", "files/publish.py",
          "        sync(folder)\n        os.unlink(folder / JOURNAL / _LIST)",
          "        os.unlink(folder / JOURNAL / _LIST)",
          (_PUBLISHING, "-k", "leaves_a_half and plain")),
    Fault("publishing: nobody reads the journal", "files/publish.py",
          "if os.path.lexists(folder / JOURNAL):", "if False:", (_PUBLISHING, "-k", "whoever")),
    Fault("environment: a plane sees behind itself", "relight/render.py",
          "sky.above_plane() if flat else sky", "sky", (_EDGES, "-k", "behind")),
    Fault("lights of any brightness", "relight/render.py",
          "        check_lights(scene.lights)\n", "", (_EDGES, "-k", "too_bright_is_named")),
    Fault("overflow is not told", "relight/render.py", "if not np.isfinite(picture).all():",
          "if False:", (_EDGES, "-k", "overflows")),
    Fault("heights of any size are written", "brdf/folder.py",
          '    check_heights(arrays["height"], "height")\n', "", (_EDGES, "-k", "no_surface")),
    Fault("rays for ever", "relight/render.py",
          "        _check_relief(self.texture, surface)\n", "", (_EDGES, "-k", "no_ray")),
    Fault("lines are triangles", "relight/surfaces/mesh.py", "(area > _SMALLEST * size**2).any()",
          "True", (_EDGES, "-k", "no_area")),
    Fault("half floats overflow", "files/exr.py", "> LARGEST_HALF", "> np.inf",
          (_EDGES, "-k", "half_float")),
)  # fmt: skip


def copied(place: Path) -> None:
    """The repository as links, in a new folder."""
    for name in ("matcap", "tests", "docs"):
        shutil.copytree(
            ROOT / name, place / name, copy_function=os.symlink,
            ignore=shutil.ignore_patterns("__pycache__"),
        )  # fmt: skip
    shutil.copy(ROOT / "pyproject.toml", place)


def passes(tests: tuple[str, ...], place: Path) -> bool:
    """Whether tests pass in a copy.

    Raises:
        RuntimeError: there are none of these names, or they cannot be run.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(tests)}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 0


def caught(fault: Fault, place: Path) -> bool:
    """Whether the tests of a copy catch a fault.

    Raises:
        ValueError: its text is not there once.
    """
    file = place / "matcap" / fault.file
    text = (ROOT / "matcap" / fault.file).read_text()
    if text.count(fault.right) != 1:
        raise ValueError(
            f"{fault.name}: its text is in {fault.file} {text.count(fault.right)} times"
        )
    file.unlink()
    file.write_text(text.replace(fault.right, fault.wrong))
    try:
        return not passes(fault.tests, place)
    finally:
        file.unlink()
        file.symlink_to(ROOT / "matcap" / fault.file)


def main() -> None:
    words = sys.argv[1:]
    chosen = [f for f in FAULTS if not words or any(word in f.name for word in words)]
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "copy"
        place.mkdir()
        copied(place)
        for tests in sorted({fault.tests for fault in chosen}):
            if not passes(tests, place):
                sys.exit(f"{' '.join(tests)} fails without any fault")
        for fault in chosen:
            began = time.monotonic()
            found = caught(fault, place)
            missed += [] if found else [fault.name]
            seconds = time.monotonic() - began
            print(
                f"{'caught' if found else 'MISSED':<8}{fault.name}  ({seconds:.0f} s)", flush=True
            )
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults caught.")
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()

"""Documentation pages do what they say."""

import re
import shlex
import shutil
from importlib import import_module
from pathlib import Path
from types import ModuleType

import guide
import numpy as np
import pytest
import torch
import typer
from guide import ROOT, anchors, commands
from lattice_tilt import tilt_about_x

import matcap as package
from matcap.batch.samples import read_settings
from matcap.capture.pipeline import capture_photo
from matcap.capture.settings import DRAWING_STAGES, EXEMPLAR_STAGES, CaptureSettings
from matcap.cli.main import command_line, main
from matcap.photo.load import load_photo
from matcap.relight.render import EFFECTS, Effect
from matcap.relight.scenefile import parse_scene

# What the pages of docs say: commands that run, and how a lattice shows its tilt.


# README runs first; the other lines of all pages are parsed.
QUICKEST = ("relight.md", "view.md")


@pytest.fixture(scope="module")
def readme_ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where README's lines ran, in order; pages are only written, for nobody closes the others."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "examples").symlink_to(ROOT / "examples")
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = re.findall(
        r"(?m)(?:^|/bin/)(matcap .*)", "".join(re.findall(r"(?s)```sh\n(.*?)```", text))
    )
    assert lines[0].startswith("matcap capture examples/photos/leather.dng")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in lines:
            if not line.startswith("matcap view") or "--html" in line:
                assert main(guide.words_of(line)) == 0, line
    return folder


@pytest.mark.capture
def test_lines_of_the_readme_run_in_order(readme_ran: Path) -> None:
    assert "Verdict" in (readme_ran / "materials" / "index.html").read_text()


@pytest.mark.capture
@pytest.mark.parametrize("page", QUICKEST)
def test_the_lines_of_a_page_run_and_leave_what_they_name(
    page: str, tmp_path: Path, readme_ran: Path
) -> None:
    faults = [
        f"{line}: {wrong}" for line, wrong in guide.run(page, tmp_path, readme_ran / "out") if wrong
    ]
    assert not faults


def test_most_pages_of_the_guide_have_lines_to_run() -> None:
    assert len(guide.pages()) >= 8


@pytest.mark.parametrize("degrees", [10.0, -6.0])
def test_the_guides_pattern_shows_its_tilt(degrees):
    """Stripes whose upper end is turned towards the camera are wider there."""
    distance, rows, columns = 1.54, 600, 800
    y, x = np.mgrid[0:rows, 0:columns] * 2.0 / columns
    slope = np.tan(np.radians(degrees)) / distance
    at = (x - 1.0) * (1.0 - slope * (rows / columns - y))
    texture = sum(np.cos(2.0 * np.pi * each * at) for each in (9.0, 13.0, 22.0))
    texture += 0.1 * np.random.default_rng(0).standard_normal(texture.shape)
    assert tilt_about_x(texture.astype(np.float32), distance)[0] == pytest.approx(degrees, abs=1.0)


# What the documentation shows: commands parse, cheap ones run, snippets work, links hold.

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
# Pages of the guide whose cheap commands are run.
RUN = ("synth", "blend")
# As shown, but smaller: as good a test.
SIZES = {"relight": "48x36", "export": "48x48"}
# What takes long, listens, trains, or needs what is not here.
LONG = {"capture", "batch", "sample", "doctor"}


def toml(page: str) -> list[str]:
    """The TOML files that a page shows."""
    return re.findall(r"```toml\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


SHOWN = sorted({line: str(p.relative_to(ROOT)) for p in PAGES for line in commands(p)}.items())
COMMAND = typer.main.get_command(command_line())


@pytest.mark.parametrize(("line", "page"), SHOWN)
def test_every_command_shown_parses(line, page):
    words = shlex.split(line)[1:]
    command, context, name = COMMAND, None, "matcap"
    # By what they can do: typer brings a click of its own, or does not, as its version will.
    while hasattr(command, "get_command"):
        context = command.make_context(name, words[:1], parent=context, resilient_parsing=True)
        name, *words = words
        found = command.get_command(context, name)
        assert found is not None, f"there is no {name}"
        command = found
    try:
        command.make_context(name, words, parent=context)
    except Exception as error:
        pytest.fail(f"{page}: {line}\n{getattr(error, 'message', error)}")


def test_the_readme_and_its_pages_show_commands():
    assert len(SHOWN) > 20


def cheap(line: str) -> bool:
    words = line.split()
    if words[1] == "view":
        return "--html" in words
    if words[1] == "synth" and words[2].startswith("-"):
        return False  # drawn by the prior, whose network is no small one
    return words[1] not in LONG and not re.search(r"[A-Z]{4,}|\.dng|\.jpg|bricks", line)


def test_files_shown_are_read(tmp_path):
    (scene,) = toml("docs/guide/relight.md")
    assert len(parse_scene(scene).lights) == 2
    (settings,) = toml("docs/guide/batch.md")
    (tmp_path / "matcap.toml").write_text(settings)
    assert read_settings(tmp_path / "matcap.toml")["group"] == "dir"


# docs/guide/export.md has a test of its own, in tests/export.
@pytest.mark.parametrize("page", [f"docs/guide/{name}.md" for name in RUN])
def test_cheap_commands_run(page, small, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(*toml("docs/guide/relight.md"))
    for name in ("leather", "cloth", "tile"):
        (tmp_path / "out" / name).mkdir(parents=True)
        small.save(tmp_path / "out" / name / f"{name}.matcap")
    ran = 0
    for line in commands(ROOT / page):
        if cheap(line):
            # As shown but for the size: of an option given twice the second counts.
            words = shlex.split(line.replace("4096x256", "600x256"))[1:]
            code = main([*words, *(["--size", SIZES[words[0]]] if words[0] in SIZES else [])])
            assert code == 0, (line, capsys.readouterr().err)
            ran += 1
    assert ran > 0


@pytest.mark.capture
def test_python_guide_runs_from_top_to_bottom(small, tmp_path, monkeypatch):
    """Everything is real but the tuning of the network."""
    from types import SimpleNamespace

    from matcap.capture import pipeline

    captured = SimpleNamespace(material=small, errors={})
    monkeypatch.setattr(pipeline, "capture_photo", lambda *_, **__: captured)
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "examples/photos/leather.dng", tmp_path)
    text = (ROOT / "docs/guide/python.md").read_text(encoding="utf-8")
    snippets = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict = {}
    for snippet in snippets:
        exec(compile(snippet, "docs/guide/python.md", "exec"), names)
    assert len(snippets) > 10 and Path("leather.html").stat().st_size > 10_000


@pytest.mark.parametrize("stages", [EXEMPLAR_STAGES, DRAWING_STAGES], ids=["example", "decoder"])
def test_how_it_works_goes_through_the_stages_of_today(stages):
    text = (ROOT / "docs/guide/how-it-works.md").read_text(encoding="utf-8")
    lists = re.findall(r"(?:^\d+\. (?:.|\n)*?(?=\n\n|\n\d+\. |\Z)\n?)+", text, re.MULTILINE)
    assert list(stages) in [re.findall(r"\*\*([a-z-][a-z -]*)\*\*", steps) for steps in lists]


def test_releases_are_called_alike():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1]
    latest = re.search(
        r"^## (\S+) - \d{4}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
    )
    assert cited == latest[1] == package.__version__


def test_hooks_before_a_commit_are_what_ci_runs():
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    entries = re.findall(r"entry: ([a-z-]+(?: [a-z]+)?)", hooks)
    ci = (ROOT / ".ci" / "run").read_text()
    assert len(entries) == 4
    assert all(re.search(rf"bin/{entry}( |$)", ci, re.MULTILINE) for entry in entries)


def test_readme_changelog_and_notes_stay_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 140
    assert len((ROOT / "CHANGELOG.md").read_text().splitlines()) <= 120
    notes = list((ROOT / "docs/notes").glob("*.md"))
    assert len(notes) <= 12 and sum(page.stat().st_size for page in notes) <= 120_000


@pytest.mark.parametrize("name", NAMES)
def test_links_and_pictures_lead_somewhere(name):
    page = ROOT / name
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.is_file(), target
        if anchor:
            assert anchor in anchors(file), target


@pytest.mark.parametrize("folder", ["view", "gallery", "shooting"])
def test_pictures_are_small_and_shown(folder):
    pictures = sorted((ROOT / "docs/images" / folder).iterdir())
    shown = " ".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size < 150_000, picture.name
        assert f"images/{folder}/{picture.name}" in shown, picture.name


def test_files_named_in_the_documentation_exist():
    named = re.compile(r"`((?:matcap|tests|examples|docs)/[\w/.-]+)`")
    for page in PAGES:
        for path in named.findall(page.read_text(encoding="utf-8")):
            assert (ROOT / path).exists(), f"{page.name}: {path}"


# The change that docs/guide/extend.md walks through, done as the page says.


@pytest.fixture
def steps() -> list[str]:
    """The page's Python, in order: effect, entry, scenes, share reached, test."""
    text = (ROOT / "docs/guide/extend.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def test_the_guides_own_effect_keeps_its_bound(steps, monkeypatch):
    effect, entry, scenes, reached, test = steps
    fuzz = ModuleType("fuzz")
    exec(compile(effect, "fuzz.py", "exec"), vars(fuzz))
    listed = eval(f"{{{entry}}}", {"Effect": Effect, "fuzz": fuzz})
    monkeypatch.setitem(EFFECTS, "fuzz", listed["fuzz"])
    monkeypatch.syspath_prepend(ROOT / "tests/relight")
    samples = import_module("bound_scenes")
    flat = import_module("relight_samples").flat
    names = {
        **vars(samples),
        "white": flat(diffuse=0.9, specular=0.0, roughness=1.0),
        "even": samples.EnvironmentLight(radiance=(1.0, 1.0, 1.0)),
    }
    exec(compile(scenes, "bound_scenes.py", "exec"), names)
    shares = [samples.share("fuzz", one) for one in names["fuzz"]()]
    assert eval(f"{{{reached}}}")["fuzz"] <= max(shares) <= 1.0
    exec(compile(test, "test_fuzz.py", "exec"), names)
    names["test_fuzz_is_the_formula"]()


# examples/capture_steps.py: the public steps put together by hand are a capture.


DETAIL = 128


@pytest.fixture
def capture_steps(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "examples")
    return import_module("capture_steps")


@pytest.mark.capture
@pytest.mark.usefixtures("one_coarse_fit")
def test_steps_by_hand_give_the_maps_of_a_capture_and_take_another_prior(capture_steps):
    photo = load_photo(ROOT / "examples" / "photos" / "leather.dng", long_side=DETAIL)
    material, maps = capture_steps.capture(photo)
    whole = capture_photo(photo, CaptureSettings(detail=DETAIL, generator="example")).material
    assert torch.equal(
        material.maps(64, 48, seed=3).stacked(), whole.maps(64, 48, seed=3).stacked()
    )

    flat, flat_maps = capture_steps.capture(photo, capture_steps.flat_prior)
    assert torch.isfinite(flat_maps.stacked()).all()
    assert flat_maps.height.std() < 0.5 * maps.height.std()  # relief is the prior's

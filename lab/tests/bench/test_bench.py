"""`matcap-lab bench`: what commands hand to their experiments and print of them."""

import math

import numpy as np
import pytest
import torch

from matcap.brdf.cook_torrance import METAL_F0
from matcap.brdf.maps import MapSet
from matcap.field.plane import Rectangle
from matcap.space.decoder import Decoder
from matcap.space.random_field import Patch, noise_field
from matcap.space.tuned import TunedDecoder
from matcap_lab.bench import fields, floors, synth
from matcap_lab.bench.fields import (
    SIZES,
    copies,
    correlation,
    fields_experiment,
    grating,
    joint_length,
    phase_off,
    repetition_experiment,
    seam_contrast,
)
from matcap_lab.bench.reflectance import PlainMaterial, f0_errors, gloss_experiment
from matcap_lab.bench.relight import (
    EVERYTHING,
    MEGAPIXEL,
    TOLERANCE,
    TOLERANCES,
    plan_experiment,
    tolerance_experiment,
)
from matcap_lab.bench.synth import PAPER_CONFIG, SynthSettings, paper_form, synth_experiment
from matcap_lab.cli.main import main
from matcap_lab.experiment.page import section
from matcap_lab.experiment.results import read
from matcap_lab.experiment.runner import Configuration, Experiment, run
from matcap_lab.measures.evaluator import EvaluationSettings
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import subjects


@pytest.fixture
def asked(monkeypatch):
    """Experiments of one number in place of the real ones; gives the arguments of their making."""
    calls = []

    def made(*arguments, **options):
        calls.append((arguments, options))
        return Experiment(
            "floors",
            {"leather": lambda: 4.3},
            {"exemplar": Configuration(lambda number, _seed: number)},
            (lambda number, _outcome: {"NSD": number, "seconds": 1.0},),
        )

    for module, name in ((fields, "fields"), (floors, "nsd")):
        monkeypatch.setattr(module, f"{name}_experiment", made)
    return calls


def test_the_table_is_printed_and_written(lab, asked, tmp_path):
    said = lab("bench", "floors", "leather", "--stops", "-0.67", "-o", tmp_path / "f")
    assert said.code == 0
    assert "| leather | exemplar | 1.00 | 4.30 |" in said.out
    assert said.err == "leather, exemplar: seconds 1.00, NSD 4.30\n"
    assert sorted(f.name for f in (tmp_path / "f").iterdir()) == ["floors.csv"]
    (((subjects, out, settings, _evaluation), _),) = asked
    assert [s.name for s in subjects] == ["leather"]
    assert (settings.ev, out) == (-0.67, tmp_path / "f")
    again = lab("bench", "floors", "leather", "--stops", "-0.67", "-o", tmp_path / "f")
    assert (again.out, again.err) == (said.out, "")


def test_fields_are_of_what_is_named(lab, asked, tmp_path):
    assert lab("bench", "fields", "leather", "-o", tmp_path).code == 0
    (((subjects,), _),) = asked
    assert [one.name for one in subjects] == ["leather"]
    assert lab("bench", "fields", "nothing").code == 2


# What `matcap-lab bench fields` and `repetition` measure.


def bricks(width, height):
    y, x = np.mgrid[:300, :400]
    shifted = (x + (y // height) % 2 * (width // 2)) % width
    return np.where((y % height < 3) | (shifted < 3), 0.0, 1.0).astype(np.float32)


def test_joints_are_as_long_as_bricks_leave_them():
    short, long = joint_length(bricks(30, 18)), joint_length(bricks(60, 36))
    assert 1.6 < long / short < 2.6
    assert joint_length(np.zeros((64, 64), np.float32)) is None


def test_a_lattice_far_away_is_in_phase():
    assert phase_off(grating(17.3, 21.0, (320, 256))) < 0.03


def test_true_maps_are_near_themselves_and_only_fields_have_joints(tmp_path, monkeypatch):
    monkeypatch.setattr(fields, "_SIZE", (256, 192))
    evaluation = EvaluationSettings(192, 128, PhoneCamera(blur=0.01), truths=2, finer=2)
    experiment = fields_experiment(subjects(["rust"]), evaluation)
    exemplar, field, repeated = run(experiment, tmp_path / "fields.csv")
    assert exemplar.number("NSD") < 3.0 and repeated.number("NSD") < 3.0
    assert field.number("variety") > 0.0
    assert 0.3 < field.number("seam albedo") < 2.0 and 0.3 < field.number("seam slope 99 %") < 2.0
    assert math.isnan(exemplar.number("seam albedo"))
    assert math.isnan(exemplar.number("variety")) and math.isnan(exemplar.number("joints"))


def noise(seed, size=512):
    return np.random.default_rng(seed).standard_normal((size, size)).astype(np.float32)


def test_a_repeat_is_found_and_chance_is_not():
    tiled = np.tile(noise(1, 256), (2, 2))
    assert correlation(tiled, tiled) == pytest.approx(1.0, abs=1e-3)
    assert correlation(noise(1), noise(1)) < 0.02
    assert correlation(noise(1), noise(2)) < 0.02
    # A copy of a quarter, 200 texels on.
    partly = noise(3)
    partly[:256, 200:456] = partly[:256, :256]
    assert 0.05 < correlation(partly, partly) < 0.5


def test_copies_are_counted_by_their_texels():
    y, x = np.mgrid[0:64, 0:64]
    places = np.stack([x, y], axis=-1).astype(np.int16)
    assert copies(places) == (0, 0, 0, 0, 1, 0, 0)  # 64 x 64 is not below 4096
    places[10:20, 30:50] += 200  # 200 texels
    found = copies(places)
    assert found[1] == pytest.approx(200 / 4096) and found[3] == pytest.approx(3896 / 4096)
    scattered = np.random.default_rng(1).integers(0, 1000, (64, 64, 2)).astype(np.int16)
    assert copies(scattered)[0] > 0.99
    assert len(found) == len(SIZES) + 1 and sum(found) == pytest.approx(1.0)


def test_a_small_field_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr("matcap_lab.bench.fields._COPIED", 256)
    monkeypatch.setattr("matcap_lab.bench.fields._EXEMPLAR", (192, 160))
    (row,) = run(repetition_experiment(["leather"], 512), tmp_path / "repetition.csv")
    assert row.number("with itself") < row.number("of two seeds") + 0.15
    assert 0.8 < row.number("diversity") < 1.2
    shares = [value for name, value in row.values.items() if name.startswith(("below", "larger"))]
    assert sum(shares) == pytest.approx(1.0, abs=1e-4)


def test_a_material_without_an_exemplar_is_refused(tmp_path, capsys):
    asked = [str(tmp_path / "none.matcap"), "--size", "512", "-o", str(tmp_path)]
    assert main(["bench", "repetition", *asked]) == 3
    assert "no such file" in capsys.readouterr().err


def test_the_command_keeps_the_lattice_of_a_simulated_material(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("matcap_lab.bench.fields._EXEMPLAR", (320, 288))
    assert main(["bench", "repetition", "tile", "--size", "512", "-o", str(tmp_path)]) == 0
    assert "| tile | 512 x 512 texels |" in capsys.readouterr().out
    (row,) = read(tmp_path / "repetition.csv")
    # What a lattice repeats by right is in both.
    assert 0.3 < row.number("with itself") < row.number("of two seeds") + 0.1


def waves(height=400, width=600):
    """(6, H, W) maps of slow noise, about sixteen texels."""
    noise = np.random.default_rng(4).standard_normal((6, height, width))
    turns = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    smooth = np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((30.0 * turns) ** 2))).real
    smooth /= smooth.std(axis=(1, 2), keepdims=True)
    maps = 0.3 * np.exp(0.2 * smooth)
    maps[5] = 0.01 * smooth[5]
    return maps.astype(np.float32)


def split(shift):
    """Places of a field whose right half lies elsewhere by a shift (x, y) of texels."""
    places = np.stack(np.meshgrid(np.arange(200), np.arange(300)), axis=-1)
    places[:, 100:] += shift
    return places


def measured_seams(maps, places, shown=None):
    shown = maps[:, places[..., 1], places[..., 0]] if shown is None else shown
    return seam_contrast(shown, places, maps, 0.002)


def test_what_was_not_rearranged_has_no_seams():
    assert np.isnan(list(measured_seams(waves(), split((0, 0))).values())).all()


def test_a_cut_shows_in_albedo_and_slope():
    found = measured_seams(waves(), split((317, 60)))
    assert found["seam albedo"] > 5.0 and found["seam slope"] > 5.0
    assert found["seam albedo 99 %"] > 3.0


def test_a_seam_that_what_it_shows_hides_measures_one():
    """Of a piece that repeats: another place, and the same texels."""
    found = measured_seams(np.tile(waves(400, 300), (1, 1, 2)), split((300, 0)))
    for name in ("seam albedo", "seam slope"):
        assert 0.8 < found[name] < 1.25 and 0.7 < found[f"{name} 99 %"] < 1.3


def test_colour_alone_shows_in_albedo_alone():
    maps = np.tile(waves(400, 300), (1, 1, 2))
    places = split((300, 0))
    shown = maps[:, places[..., 1], places[..., 0]].copy()
    shown[0, :, 100:] *= 1.5
    found = measured_seams(maps, places, shown)
    assert found["seam albedo"] > 5.0 and 0.8 < found["seam slope"] < 1.25


# The benches of gloss and metals: what is found, where it is known.


SATIN = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.0)


@pytest.mark.parametrize("size", [(256, 192), (512, 384)])
def test_bumps_are_as_steep_as_asked_for_at_any_detail(size):
    maps = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.1).realise(*size, 2.0 / size[0])
    down, across = np.gradient(maps.height[0].numpy() / maps.texel_size)
    assert np.sqrt((down**2 + across**2).mean()) == pytest.approx(0.1, rel=1e-3)


def test_polish_is_found_though_two_stops_of_its_highlight_are_clipped(tmp_path):
    camera = PhoneCamera(800, 600, supersampling=1)
    experiment = gloss_experiment(iter([SATIN]), (0, 2), camera=camera)
    whole, clipped = run(experiment, tmp_path / "gloss.csv")
    assert clipped.number("clipped") > 2.0 * whole.number("clipped")
    assert (whole.configuration, whole.subject) == ("+0 EV", "0, 0.3, 0.04, 0.2")
    for row in (whole, clipped):
        assert row.number("roughness") == pytest.approx(0.2, abs=0.05)
        assert row.number("near") == 1.0


GOLD = torch.tensor(METAL_F0["gold"])[:, None, None]


def maps(specular: torch.Tensor) -> MapSet:
    one = torch.ones(1, 8, 16)
    return MapSet(0.1 * one.expand(3, -1, -1), specular, 0.4 * one, 0.0 * one, 0.1)


def half(metal, rest) -> torch.Tensor:
    """(C, 8, 16): metal on the left, the rest on the right."""
    left = torch.as_tensor(metal).expand(-1, 8, 8)
    return torch.cat([left, torch.full_like(left, rest)], -1)


def test_brightness_hue_and_what_lies_beside_are_told_apart() -> None:
    truth = maps(half(GOLD, 0.04))
    blue = GOLD * torch.tensor([0.5, 0.5, 0.6])[:, None, None]
    values = f0_errors(maps(half(blue, 0.06)), truth)
    colours = ("red", "green", "blue")
    assert [values[name] for name in colours] == pytest.approx([0.5, 0.5, 0.6])
    mean = float(blue.sum() / GOLD.sum())
    hue = [100.0 * (one / mean - 1.0) for one in (0.5, 0.5, 0.6)]
    assert [values[f"{name} hue"] for name in colours] == pytest.approx(hue)
    assert (values["dielectric"], values["true dielectric"]) == pytest.approx((0.06, 0.04))


def test_truth_on_a_finer_grid_and_a_grey_answer() -> None:
    truth = maps(GOLD.expand(-1, 8, 16))
    fine = truth.map(lambda m: m.repeat_interleave(2, -1).repeat_interleave(2, -2))
    values = f0_errors(maps(0.7 * torch.ones(1, 8, 16)), fine)
    assert math.isnan(values["dielectric"]) and math.isnan(values["red hue"])
    assert values["red"] == pytest.approx(0.7 / METAL_F0["gold"][0])


# Time against accuracy of relighting: what is left out stays within its tolerance.

SCENE = """
[surface]
displacement = 0.0
[[light]]
type = "point"
position = [0.0, 1.0, 2.0]
intensity = [6.0, 6.0, 6.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    (folder / "lamp.toml").write_text(SCENE)
    return folder


@pytest.fixture(scope="module")
def measured(folder):
    experiment = tolerance_experiment([folder / "lamp.toml"], width=16, texels=32, repeats=1)
    return run(experiment, folder / "tolerances.csv")


def test_no_tolerance_is_exceeded_and_all_effects_are_exact(measured):
    steps = {row.configuration: row.number("steps") for row in measured}
    for most in TOLERANCES:
        assert steps[f"{most:g} steps"] <= most
    assert steps[EVERYTHING] == pytest.approx(0.0, abs=1e-4)
    assert steps["diffuse alone"] > 0.5
    assert all(row.number("seconds") > 0.0 and row.subject == "lamp" for row in measured)


def test_its_page_and_picture_are_of_the_table(measured, folder):
    pytest.importorskip("matplotlib", reason="needs the extra `bench`")
    result = section(folder / "tolerances.csv", TOLERANCE, folder / "page.md")
    assert sum(line.startswith("| * | ") for line in result) >= 1
    assert sum(" | lamp" in line or "steps | " in line for line in result) >= len(TOLERANCES)
    assert (folder / "tolerances.png").stat().st_size > 1000


def test_a_megapixel_has_no_other_effects_than_its_plan(folder):
    experiment = plan_experiment([folder / "lamp.toml"], repeats=1)
    assert experiment.skips(MEGAPIXEL, EVERYTHING) and not experiment.skips("lamp", EVERYTHING)
    found = experiment.configurations["plan"].run(experiment.subjects["lamp"](), 0)
    assert found["effects"] >= 1.0 and found["seconds"] > 0.0


# What synthesis is measured beside: the paper's form is the network, and every step is counted.


def test_the_papers_network_has_its_size():
    decoder = Decoder(PAPER_CONFIG)
    weights = [layer.convolution.weight for layer in decoder.layers()]
    skipped = 4 * 9 * 12  # weights of waves, per channel of the four levels on the way up
    waves = sum(skipped // 4 * width for width in PAPER_CONFIG.widths[:-1])
    count = sum(w.numel() for w in weights) - waves
    affine = sum(p.numel() for p in decoder.parameters()) - sum(w.numel() for w in weights)
    assert 2.0e6 < count + affine < 3.0e6


def test_the_papers_form_is_the_decoder_but_for_the_blur(material, monkeypatch):
    monkeypatch.setattr(synth, "_blurred", lambda features: features)
    noise = noise_field(Patch(1, Rectangle(0, 0, 96, 64)), 2)[None]
    from matcap.space.random_field import random_field

    field = random_field(Patch(1, Rectangle(0, 0, 96, 64), period=(96, 64)), 2, (), levels=4)
    with torch.no_grad():
        tuned = material.part(TunedDecoder)
        found = paper_form(tuned.decoder, tuned.code, noise.contiguous())
        expected = tuned.decoder(field, tuned.code)
    # Its upsampling does not know that the field is periodic: only the inside is alike.
    inner = (..., slice(24, 40), slice(24, 72))
    assert float((found - expected)[inner].abs().mean()) < 0.3 * float(expected.std())


@pytest.mark.usefixtures("two_threads")
def test_a_short_run_fills_the_table(tmp_path):
    settings = SynthSettings((64, 32), ("shipped",), ("64x32",), (1,), 1, (120, 96))
    experiment = synth_experiment(settings)
    rows = run(experiment, tmp_path / "synth.csv")
    assert torch.get_num_threads() == 2
    of_network = [row for row in rows if row.subject == "shipped"]
    assert len(rows) == len(experiment.configurations)
    for row in of_network:
        paper, seconds = row.number("paper"), row.number("seconds")
        assert row.number("ratio") == pytest.approx(paper / seconds, rel=1e-3)
    assert rows[-1].configuration == "180x180, 1 workers" and rows[-1].number("a megatexel") > 0.0

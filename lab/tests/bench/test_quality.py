import importlib.util
import sys

import pytest
import torch
import torch.nn.functional as F

from matcap.errors import MatcapError, UsageError
from matcap_lab.bench.methods import CapturedMaps, photo_as_albedo
from matcap_lab.bench.nsd import quality_experiment
from matcap_lab.experiment.runner import run
from matcap_lab.measures.evaluator import EvaluationSettings, Evaluator
from matcap_lab.measures.lights import relight_all
from matcap_lab.measures.style import PortillaSimoncelli, RandomFilters, difference
from matcap_lab.simulate.photograph import PhoneCamera, as_photo
from matcap_lab.simulate.specimen import EXAMPLES

needs_plenoptic = pytest.mark.skipif(
    importlib.util.find_spec("plenoptic") is None, reason="plenoptic (extra bench) is missing"
)
# Small and coarse, for speed: what is tested is order, not figures.
CAMERA = PhoneCamera(width=512, height=384, supersampling=1)
SETTINGS = EvaluationSettings(512, 192, CAMERA, finer=2, every=1, first=1001)


@pytest.fixture(scope="module", params=["filters", pytest.param("grey", marks=needs_plenoptic)])
def style(request):
    if request.param == "filters":
        return RandomFilters()
    return PortillaSimoncelli((SETTINGS.size, SETTINGS.size))


@pytest.fixture(scope="module")
def shot():
    return EXAMPLES["leather"].take(CAMERA)


@pytest.fixture(scope="module")
def evaluator(style, shot):
    return Evaluator(EXAMPLES["leather"], shot.setup, SETTINGS, {"one": style})


def _pictures(evaluator, shot, material="leather"):
    """Another true piece, seen as the evaluator's."""
    size, blur = SETTINGS.size, CAMERA.blur * 2 * SETTINGS.detail / CAMERA.width
    maps = EXAMPLES[material].pieces(55)(2 * size, 2 * size, 1.0 / SETTINGS.detail)
    return relight_all(maps, shot.setup.intensity, evaluator.scene, size=(size, size), blur=blur)


@pytest.fixture(scope="module")
def truth(evaluator, shot):
    return _pictures(evaluator, shot)


def test_another_true_piece_scores_one(evaluator, truth):
    assert evaluator.style_ratio(truth) == pytest.approx(1.0, abs=0.25)


def test_blur_and_colour_are_noticed(evaluator, truth):
    right = evaluator.style_ratio(truth)
    kernel = torch.ones(3, 1, 5, 5) / 25
    blurred = F.conv2d(F.pad(truth, (2, 2, 2, 2), mode="reflect"), kernel, groups=3)
    recoloured = truth * torch.tensor([0.7, 1.0, 1.3])[:, None, None]
    darker = 0.7 * truth
    for wrong in (blurred, recoloured.clamp(0, 1), darker):
        assert evaluator.style_ratio(wrong) > 1.25 * right


def test_error_grows_towards_a_wrong_material(evaluator, truth, shot):
    wrong = _pictures(evaluator, shot, "plaster")
    errors = [
        evaluator.style_ratio(torch.lerp(truth, wrong, share)) for share in (0.0, 0.4, 0.7, 1.0)
    ]
    assert errors == sorted(errors)
    assert errors[-1] > 2.5


def test_black_pictures_compare(style):
    """A light below a bump's horizon may leave nothing; no division by zero."""
    size = SETTINGS.size
    generator = torch.Generator().manual_seed(2)
    speck = 1e-3 * torch.rand(1, 3, size, size, generator=generator)
    assert torch.isfinite(difference(style(speck), style(0.5 * speck))).all()


def test_photo_as_albedo_gives_the_photograph_back(shot):
    """Under its own flash its mean is right; that it bakes the flash in is what the bench shows."""
    photo = as_photo(shot, 1, "leather")
    captured = photo_as_albedo(photo, shot.setup, SETTINGS.detail)
    maps = captured.maps.crop(160, 96, 192, 192)
    assert maps.texel_size == 2.0 / SETTINGS.detail
    middle = torch.from_numpy(photo.pixels).permute(2, 0, 1)[:, 96:288, 160:352]
    assert float((maps.diffuse - middle).abs().mean()) < 0.05


@needs_plenoptic
def test_run_measures_every_method_and_writes_what_it_saw(tmp_path):
    """With the truth for a capture: far below the photograph as albedo.

    Not at the floor: true maps sampled at this detail alias, a camera's picture of them does not.
    """

    def perfect(path):
        example = EXAMPLES[path.stem]
        assert path.is_file()
        setup = example.take(CAMERA).setup
        maps = EXAMPLES[example.name].pieces(77)(400, 300, 2.0 / SETTINGS.detail)
        return CapturedMaps(maps, setup)

    lines = []
    methods = ["decoder", "photo-as-albedo"]
    experiment = quality_experiment(
        perfect, tmp_path, materials=["plaster"], methods=methods, settings=SETTINGS
    )
    table = tmp_path / "quality.csv"
    rows = run(experiment, table, lines.append)
    assert [row.configuration for row in rows] == methods and len(lines) == 2
    assert rows[0].number("mean") < 0.6 * rows[1].number("mean")
    both = (rows[0].number("PS") + rows[0].number("RF")) / 2.0
    assert rows[0].number("mean") == pytest.approx(both, rel=1e-4)
    assert (tmp_path / "plaster.png").is_file()
    assert [row.line for row in run(experiment, table)] == [row.line for row in rows]


@needs_plenoptic
@pytest.mark.parametrize("wrong", [{"materials": ["velvet"]}, {"methods": ["magic"]}])
def test_unknown_names_are_usage_errors(tmp_path, wrong):
    with pytest.raises(UsageError, match="choose from"):
        quality_experiment(None, tmp_path, settings=SETTINGS, **wrong)


def test_plenoptic_missing_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "plenoptic.models", None)
    with pytest.raises(MatcapError, match=r"pip install 'matcap\[bench\]'"):
        PortillaSimoncelli((64, 64))

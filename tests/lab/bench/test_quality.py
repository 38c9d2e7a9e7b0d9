import importlib.util
import sys

import pytest
import torch
import torch.nn.functional as F

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError, UsageError
from matcap.lab.bench import quality
from matcap.lab.bench.baselines import Fixed, photo_as_albedo
from matcap.lab.bench.quality import Score, Yardstick, comma_separated, markdown, write_scores
from matcap.lab.bench.relit import relight_all
from matcap.lab.bench.style import PortillaSimoncelli, RandomFilters, difference
from matcap.lab.simulate.examples import EXAMPLES, realisation
from matcap.lab.simulate.photograph import as_photo

needs_plenoptic = pytest.mark.skipif(
    importlib.util.find_spec("plenoptic") is None, reason="plenoptic (extra bench) is missing"
)


@pytest.fixture(scope="module", params=["filters", pytest.param("grey", marks=needs_plenoptic)])
def style(request, settings):
    if request.param == "filters":
        return RandomFilters()
    return PortillaSimoncelli((settings.size, settings.size))


@pytest.fixture(scope="module")
def shot(settings):
    return EXAMPLES["leather"].take(settings.camera)


@pytest.fixture(scope="module")
def yardstick(style, shot, settings):
    return Yardstick("leather", shot.setup, settings, [style])


def _pictures(yardstick, shot, settings, material="leather", seed=55):
    """Another true piece, seen as the yardstick's."""
    fine = 2 * settings.size
    maps = realisation(material, seed)(fine, fine, 1.0 / settings.detail)
    blur = settings.camera.blur * 2 * settings.detail / settings.camera.width
    return relight_all(
        maps, shot.setup.intensity, yardstick.scene, size=(settings.size, settings.size), blur=blur
    )


@pytest.fixture(scope="module")
def truth(yardstick, shot, settings):
    return _pictures(yardstick, shot, settings)


def test_another_true_piece_scores_one(yardstick, truth):
    assert yardstick.measure(truth)[0] == pytest.approx(1.0, abs=0.25)


def test_blur_and_colour_are_noticed(yardstick, truth):
    right = yardstick.measure(truth)[0]
    kernel = torch.ones(3, 1, 5, 5) / 25
    blurred = F.conv2d(F.pad(truth, (2, 2, 2, 2), mode="reflect"), kernel, groups=3)
    recoloured = truth * torch.tensor([0.7, 1.0, 1.3])[:, None, None]
    darker = 0.7 * truth
    for wrong in (blurred, recoloured.clamp(0, 1), darker):
        assert yardstick.measure(wrong)[0] > 1.25 * right


def test_error_grows_towards_a_wrong_material(yardstick, truth, shot, settings):
    wrong = _pictures(yardstick, shot, settings, material="plaster")
    errors = [
        yardstick.measure(torch.lerp(truth, wrong, share))[0] for share in (0.0, 0.4, 0.7, 1.0)
    ]
    assert errors == sorted(errors)
    assert errors[-1] > 2.5


def test_difference_is_a_symmetric_bounded_distance(style, settings):
    generator = torch.Generator().manual_seed(1)
    size = settings.size
    pictures = torch.rand(2, 3, size, size, generator=generator)
    one, other = style(pictures), style(0.3 * pictures.flip(0))
    torch.testing.assert_close(difference(one, one), torch.zeros(2))
    torch.testing.assert_close(difference(one, other), difference(other, one))
    assert (difference(one, other) <= 2.0).all()


def test_black_pictures_compare(style, settings):
    """A light below a bump's horizon may leave nothing; no division by zero."""
    size = settings.size
    generator = torch.Generator().manual_seed(2)
    speck = 1e-3 * torch.rand(1, 3, size, size, generator=generator)
    assert torch.isfinite(difference(style(speck), style(0.5 * speck))).all()


def test_photo_as_albedo_gives_the_photograph_back(shot, settings):
    """Under its own flash its mean is right; that it bakes the flash in is what the bench shows."""
    photo = as_photo(shot, 1, "leather")
    captured = photo_as_albedo(photo, shot.setup, settings.detail)
    maps = captured.maps(192, 192, seed=3)
    assert maps.size == (192, 192)
    assert maps.texel_size == 2.0 / settings.detail
    middle = torch.from_numpy(photo.pixels).permute(2, 0, 1)[:, 96:288, 160:352]
    assert float((maps.diffuse - middle).abs().mean()) < 0.05
    with pytest.raises(UsageError, match="512 x 384 texels"):
        captured.maps(600, 100)


@needs_plenoptic
def test_run_measures_every_method_and_writes_what_it_saw(tmp_path, settings):
    """With the truth for a capture: far below the photograph as albedo.

    Not at the floor: true maps sampled at this detail alias, a camera's picture of them does not.
    """

    def perfect(path):
        example = EXAMPLES[path.stem]
        assert path.is_file()
        setup = example.take(settings.camera).setup
        maps = realisation(example.material, 77)(400, 300, 2.0 / settings.detail)
        return Fixed(maps, setup)

    lines = []
    scores = quality.run_quality(
        perfect,
        tmp_path,
        materials=["plaster"],
        methods=["decoder", "photo-as-albedo"],
        settings=settings,
        tell=lines.append,
    )
    assert [score.method for score in scores] == ["decoder", "photo-as-albedo"]
    assert len(lines) == 2
    assert scores[0].mean < 0.6 * scores[1].mean
    assert (tmp_path / "plaster.png").is_file()


@needs_plenoptic
def test_maps_of_another_detail_are_refused(tmp_path, settings):
    flat = torch.zeros(1, 200, 200)
    maps = MapSet(flat.expand(3, -1, -1), flat, flat, flat, texel_size=2.0 / 300)

    def coarse(path):
        return Fixed(maps, EXAMPLES["plaster"].setup)

    with pytest.raises(UsageError, match="capture with a detail of 512"):
        quality.run_quality(
            coarse, tmp_path, materials=["plaster"], methods=["decoder"], settings=settings
        )


def test_unknown_names_are_usage_errors(tmp_path):
    for wrong in ({"materials": ["velvet"]}, {"methods": ["magic"]}):
        with pytest.raises(UsageError, match="choose from"):
            quality.run_quality(None, tmp_path, **wrong)
    assert not list(tmp_path.iterdir())


def test_plenoptic_missing_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "plenoptic.models", None)
    with pytest.raises(MatcapError, match=r"pip install 'matcap\[bench\]'"):
        PortillaSimoncelli((64, 64))


SCORES = [
    Score("leather", "decoder", 1.5, 2.5, 60.0),
    Score("tile", "decoder", 2.5, 3.5, 70.0),
    Score("tile", "per-texel", 4.0, 6.0, 50.0),
]


def test_table_has_scores_means_and_the_command():
    text = markdown(SCORES, "matcap bench quality")
    assert "    matcap bench quality" in text
    assert "| leather | decoder | 1.50 | 2.50 | 2.00 | 60 |" in text
    assert "| mean | decoder | 2.00 | 3.00 | 2.50 | 65 |" in text
    assert "| mean | per-texel | 4.00 | 6.00 | 5.00 | 50 |" in text


def test_csv_and_markdown_are_written(tmp_path):
    write_scores(SCORES, tmp_path / "new", "matcap bench quality")
    lines = (tmp_path / "new" / "quality.csv").read_text().splitlines()
    assert lines[0].split(",")[:2] == ["material", "method"]
    assert lines[1] == "leather,decoder,1.5000,2.5000,2.0000,60.0000"
    assert lines == comma_separated(SCORES).splitlines()
    assert (tmp_path / "new" / "quality.md").read_text() == markdown(SCORES, "matcap bench quality")

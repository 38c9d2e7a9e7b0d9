"""Style distances that nothing is tuned by, colours by XYZ, and how unlike realisations are."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.files.color import srgb_encode
from matcap.flash.geometry import FlashSetup, camera_in_plane
from matcap_lab.measures.evaluator import (
    BenchScene,
    bench_scene,
    highlight_contrast,
    imprint,
    mirror_point,
    mirrored_scene,
    relight_all,
)
from matcap_lab.measures.nsd import SqueezeNet, SqueezeNetStyle, StyleRatio, style_distance
from matcap_lab.measures.style import (
    BINS,
    Group,
    Patches,
    RandomFilters,
    describe_pictures,
    difference,
    diversity,
    srgb_encode_tensor,
    style_distances,
    variety,
    xyz_difference,
    xyz_histograms,
)
from matcap_lab.simulate.files import REC709_TO_XYZ
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import EXAMPLES


@pytest.fixture(scope="module")
def style():
    return SqueezeNetStyle(random_network(0))


def random_network(seed):
    torch.manual_seed(seed)
    return SqueezeNet()


def ncnn(network):
    """A network's weights as ncnn writes them."""
    data = b""
    for module in network.modules():
        if isinstance(module, torch.nn.Conv2d):
            half = module.weight.numpy().astype("<f2").tobytes()
            data += struct.pack("<I", 0x01306B47) + half + b"\0" * (-len(half) % 4)
            data += module.bias.numpy().astype("<f4").tobytes()
    return data


def stripes(period, phase=0.0, size=128):
    wave = 0.5 + 0.3 * torch.sin(2.0 * torch.pi * (torch.arange(size) + phase) / period)
    return wave.expand(1, 3, size, size)


def test_weights_are_read_in_ncnn_s_order(tmp_path):
    network = random_network(1)
    path = tmp_path / "weights.bin"
    path.write_bytes(ncnn(network) + b"classifier")
    picture = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(2))
    for read, written in zip(SqueezeNet.load(path)(picture), network(picture), strict=True):
        assert torch.allclose(read, written, atol=2e-3)


@pytest.mark.parametrize("change", [lambda d: d[:5000], lambda d: b"?" + d[1:]])
def test_another_file_is_refused(tmp_path, change):
    path = tmp_path / "weights.bin"
    path.write_bytes(change(ncnn(random_network(1))))
    with pytest.raises(MatcapError, match=r"not SqueezeNet 1\.1"):
        SqueezeNet.load(path)


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(MatcapError, match="cannot be read"):
        SqueezeNet.load(tmp_path / "none.bin")


def test_places_do_not_count_and_patterns_do():
    style = SqueezeNetStyle()
    moved = style_distance(style, stripes(8), stripes(8, phase=3))
    assert style_distance(style, stripes(8), stripes(13)) > 2.0 * moved


def test_another_true_sample_has_a_normalised_distance_of_1(style):
    generator = torch.Generator().manual_seed(0)
    samples = [torch.rand(1, 3, 128, 128, generator=generator) for _ in range(3)]
    nsd = StyleRatio(style, samples[1:])
    assert nsd.of(samples[0]) == pytest.approx(1.0, abs=0.3)
    assert nsd.of(stripes(8)) > 3.0


# By the code of 2026-11-25, whose measurements docs/bench holds: distances of the first picture to
# the second and third, and normalised distance of the third to both.
REFERENCES = {
    SqueezeNetStyle: (0.8396788, 1.0320144, 1.0659100),
    Patches: (0.1768731, 0.1749630, 1.1018112),
    RandomFilters: (0.8063543, 0.9300728, 1.1456383),
}


@pytest.mark.parametrize("kind", REFERENCES)
def test_distances_stay_what_was_measured_by(kind):
    generator = torch.Generator().manual_seed(5)
    first, second, third = (torch.rand(2, 3, 128, 128, generator=generator) for _ in range(3))
    second = 0.3 + 0.5 * second
    wave = torch.sin(torch.arange(128) / 9.0).expand(2, 3, 128, 128)
    third = (0.5 * third + 0.25 * wave + 0.25).clamp(0, 1)
    style = kind()
    found = (
        style_distance(style, first, second),
        style_distance(style, first, third),
        StyleRatio(style, [first, second]).of(third),
    )
    assert found == pytest.approx(REFERENCES[kind], rel=1e-3)


@pytest.mark.parametrize("kind", REFERENCES)
def test_a_distance_is_0_for_equals_symmetric_and_bounded(kind):
    generator = torch.Generator().manual_seed(1)
    style, first = kind(), torch.rand(1, 3, 192, 192, generator=generator)
    second = 0.3 * first.flip(2)
    assert style_distance(style, first, first) == 0.0
    there, back = style_distance(style, first, second), style_distance(style, second, first)
    assert there == pytest.approx(back) and 0.0 < there <= 2.0


@pytest.mark.parametrize(("kind", "side"), [(SqueezeNetStyle, 64), (Patches, 40)])
def test_small_pictures_are_refused(kind, side):
    with pytest.raises(ValueError, match="too small"):
        kind()(torch.zeros(1, 3, side, side))


def noise(seed, scale=1.0):
    generator = torch.Generator().manual_seed(seed)
    return (0.5 + 0.1 * scale * torch.randn(2, 3, 96, 96, generator=generator)).clamp(0.0, 1.0)


def patches_apart(first, second):
    style = Patches()
    return float(difference(style(first), style(second)).mean())


def test_where_patches_are_does_not_count_and_how_often_they_occur_does():
    first = noise(0)
    moved = patches_apart(first, first.roll((13, 29), (2, 3)))
    assert moved < 0.3 * patches_apart(first, noise(1, 2.0))
    assert moved < 0.3 * patches_apart(first, first + 0.1)


def test_patches_tell_grain_from_blotches_of_the_same_contrast():
    blotches = torch.nn.functional.avg_pool2d(torch.nn.functional.pad(noise(2), [2] * 4), 5, 1)
    blotches = 0.5 + (blotches - 0.5) * 0.1 / float(blotches.std())
    assert patches_apart(noise(0), blotches) > 3.0 * patches_apart(noise(0), noise(1))


def picture(seed: int, size: int = 64) -> torch.Tensor:
    return torch.rand(3, size, size, generator=torch.Generator().manual_seed(seed))


def test_the_matrix_takes_white_to_d65():
    # x = 0.3127, y = 0.3290 (IEC 61966-2-1, table 1)
    x, y, z = REC709_TO_XYZ.sum(axis=1)
    assert y == pytest.approx(1.0)
    assert (x / (x + y + z), y / (x + y + z)) == pytest.approx((0.3127, 0.3290), abs=1e-4)


def test_histograms_are_shares():
    shares = xyz_histograms(picture(0))
    assert shares.shape == (3, BINS)
    assert shares.sum(axis=1) == pytest.approx(1.0)
    black, white = xyz_histograms(torch.zeros(3, 4, 4)), xyz_histograms(torch.ones(3, 4, 4))
    assert (black[:, 0] == 1.0).all()
    assert (white[:, -1] == 1.0).all()


def test_a_picture_has_its_own_colours_in_any_order():
    one = picture(1)
    order = torch.randperm(64 * 64, generator=torch.Generator().manual_seed(2))
    shuffled = one.flatten(1)[:, order].reshape(one.shape)
    assert xyz_difference(one, one) == 0.0
    assert xyz_difference(one, shuffled) == 0.0


def test_other_colours_are_apart_either_way_round():
    one = 0.5 * picture(3)
    redder = one * torch.tensor([1.5, 1.0, 1.0])[:, None, None]
    apart = xyz_difference(one, redder)
    assert 0.05 < apart < 1.0
    assert xyz_difference(redder, one) == apart
    assert xyz_difference(torch.zeros(3, 8, 8), torch.ones(3, 5, 5)) == 1.0


def test_the_same_picture_again_is_no_diversity():
    assert diversity(torch.stack([picture(4)] * 3)) == 0.0
    assert diversity(picture(4)[None]) == 0.0
    assert diversity(torch.zeros(2, 3, 64, 64)) == 0.0


def test_diversity_sees_places_more_than_faint_noise():
    one = picture(5)
    moved = one.roll((13, 29), dims=(-1, -2))
    noisy = one + 0.02 * torch.randn(one.shape, generator=torch.Generator().manual_seed(6))
    assert diversity(torch.stack([one, moved])) > 10.0 * diversity(torch.stack([one, noisy]))


def test_diversity_is_the_mean_over_pairs():
    one, two, three = picture(7), picture(8), picture(9)
    pairs = [diversity(torch.stack(pair)) for pair in ((one, two), (one, three), (two, three))]
    assert diversity(torch.stack([one, two, three])) == pytest.approx(sum(pairs) / 3.0)


# Precision and recall of made pictures: what the sets are made of is known.


def points(values):
    """Statistics of made-up pictures: one group of numbers far from 0, where distances are even."""
    return {"group": Group(100.0 + torch.as_tensor(values, dtype=torch.float32), 0.0)}


def cloud(count, centre, seed):
    return centre + torch.randn(count, 4, generator=torch.Generator().manual_seed(seed))


def test_the_same_distribution_has_both():
    found = variety(points(cloud(200, 0.0, 1)), points(cloud(200, 0.0, 2)))
    assert found.precision > 0.9
    assert found.recall > 0.9
    assert found.spread == pytest.approx(1.0, abs=0.1)


def test_one_of_two_modes_is_precise_and_recalls_half():
    true = torch.cat([cloud(100, 0.0, 1), cloud(100, 20.0, 2)])
    found = variety(points(cloud(100, 0.0, 3)), points(true))
    assert found.precision > 0.9
    assert found.recall == pytest.approx(0.5, abs=0.06)
    assert found.spread < 0.4


def test_what_lies_elsewhere_has_neither():
    found = variety(points(cloud(50, 40.0, 1)), points(cloud(50, 0.0, 2)))
    assert (found.precision, found.recall) == (0.0, 0.0)


def test_the_nearest_is_told():
    true = torch.tensor([[0.0], [10.0], [20.0], [30.0], [40.0]])
    made = torch.tensor([[21.0], [1.0], [39.0], [11.0]])
    assert variety(points(made), points(true)).nearest.tolist() == [2, 0, 4, 1]


def test_distances_are_those_of_single_pictures():
    pictures = torch.rand(3, 3, 160, 160, generator=torch.Generator().manual_seed(0))
    result = describe_pictures(list(pictures))
    found, style = style_distances(result, result), RandomFilters()
    wanted = float(difference(style(pictures[:1]), style(pictures[2:])))
    assert float(found[0, 2]) == pytest.approx(wanted, rel=1e-4)
    assert float(found.diagonal().abs().max()) < 1e-6


# Materials under the bench's lights and mirrored ones, and the imprint of the flash.

FLASH = FlashSetup(fov=65.0, intensity=(2.0, 2.0, 2.0))
BENCH = bench_scene(FLASH)
MIRRORED = mirrored_scene(FLASH)


def even(size, texel=2.0 / 256, *, albedo=0.5, specular=0.0, roughness=1.0):
    one = torch.ones(1, size, size)
    return MapSet(albedo * one.expand(3, -1, -1), specular * one, roughness * one, 0.0 * one, texel)


def relight(maps, light, intensity=FLASH.intensity, **options):
    """A picture under one light."""
    return relight_all(maps, intensity, BenchScene(FLASH.distance, (light,)), **options)[0]


@pytest.mark.parametrize("example", EXAMPLES.values(), ids=EXAMPLES)
def test_lights_are_never_at_the_flash(example):
    setup = FlashSetup(fov=PhoneCamera().fov, offset=example.setup.offset, tilt=example.setup.tilt)
    flash = camera_in_plane(setup)[1]
    for light in bench_scene(setup).lights:
        place = torch.tensor(light.place, dtype=torch.float64)
        cosine = torch.dot(place, flash) / (place.norm() * flash.norm())
        assert math.degrees(math.acos(float(cosine))) > 12.0


def test_ten_lights_are_spread_over_the_hemisphere():
    places = np.array([light.place for light in BENCH.lights])
    assert len(places) == 10
    distance = np.linalg.norm(places, axis=1)
    assert distance.min() >= 1.5 and distance.max() <= 3.0 + 1e-9 and np.ptp(distance) > 1.0
    quadrants = {(bool(x > 0), bool(y > 0)) for x, y, _ in places}
    assert len(quadrants) == 4
    assert (places[:, 2] > 0.5).all()


def test_every_light_gives_the_flash_s_brightness_in_the_middle():
    expected = 0.5 / math.pi * 2.0 / FLASH.distance**2
    for light in BENCH.lights:
        linear = ((relight(even(65), light)[:, 32, 32] + 0.055) / 1.055) ** 2.4
        # Schlick's term leaves a little specular even at F0 = 0.
        np.testing.assert_allclose(linear, expected, rtol=0.05)


def test_gain_between_flash_and_albedo_cancels():
    for light in BENCH.lights[:3]:
        first = relight(even(32), light)
        second = relight(even(32, albedo=0.25), light, (4.0, 4.0, 4.0))
        assert torch.allclose(first, second, atol=0.01)


def test_strips_do_not_show():
    """Larger than a strip of rows; a tilted plane lit evenly has no lines."""
    maps = even(300)
    height = 0.3 * maps.texel_size * torch.arange(300.0)[None, :, None].expand(1, 300, 300)
    picture = relight(replace(maps, height=height), BENCH.lights[4])
    assert (picture[:, 2:] - 2 * picture[:, 1:-1] + picture[:, :-2]).abs().max() < 1e-3


def test_finer_maps_are_averaged():
    light = BENCH.lights[2]
    coarse = relight(even(64), light)
    fine = relight(even(128, 1.0 / 256), light, size=(64, 64))
    torch.testing.assert_close(fine, coarse, atol=1e-4, rtol=0)
    torch.testing.assert_close(relight(even(64), light, blur=0.8), coarse, atol=2e-3, rtol=0)


def test_what_pixels_show_of_finer_maps_is_their_mean_radiance():
    # A checkerboard of black and white: half of white's light, not half of its code.
    maps = even(64, albedo=0.5 * ((torch.arange(64)[:, None] + torch.arange(64)) % 2))
    seen = relight(maps, BENCH.lights[2], size=(32, 32))
    grey = relight(even(32, 2.0 / 128), BENCH.lights[2], (1.0, 1.0, 1.0))
    torch.testing.assert_close(seen, grey, atol=2e-3, rtol=0)


def test_every_mirror_image_is_in_the_picture() -> None:
    for light in MIRRORED.lights:
        assert max(map(abs, mirror_point(MIRRORED, light.place))) < 0.5


def test_glossier_is_stronger_and_matte_is_one() -> None:
    contrasts = [
        highlight_contrast(even(128, 1.0 / 128, albedo=0.2, specular=0.04, roughness=r), MIRRORED)
        for r in (0.25, 0.4, 0.95)
    ]
    assert contrasts[0] > 2.0 * contrasts[1] > 2.0 * contrasts[2]
    assert contrasts[2] == pytest.approx(1.0, abs=0.05)


def test_rings_are_an_imprint_and_noise_is_none() -> None:
    v, u = torch.meshgrid(torch.arange(128.0), torch.arange(192.0), indexing="ij")
    away = torch.hypot(u - 96.0 - 19.2, v - 64.0)
    noise = torch.randn(128, 192, generator=torch.Generator().manual_seed(1))
    assert imprint(torch.sin(away * 0.5), (0.2, 0.0)) > 0.8
    assert abs(imprint(noise, (0.2, 0.0))) < 0.15
    assert abs(imprint(torch.sin(0.5 * u), (0.2, 0.0))) < 0.25  # a material's own direction
    assert imprint(torch.zeros(128, 192), (0.2, 0.0)) == 0.0


def test_srgb_of_tensors_is_the_products_with_a_gradient_on_both_sides_of_the_knee():
    values = torch.tensor([-0.2, 0.0, 1e-3, 0.02, 0.06, 0.5, 2.0], dtype=torch.float64)
    np.testing.assert_allclose(srgb_encode_tensor(values).numpy(), srgb_encode(values.numpy()))
    assert torch.autograd.gradcheck(srgb_encode_tensor, values.requires_grad_())

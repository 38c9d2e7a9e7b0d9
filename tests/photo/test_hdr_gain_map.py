"""HDR gain maps: light by the formulas of the standards, and files that state too little."""

import contextlib
import importlib.util
from dataclasses import replace

import cv2
import numpy as np
import pytest
from gain_map_files import apple_xmp, exif, hdrgm, iso, jpeg, maker_note, write
from icc_files import matrix_profile, parametric

from matcap.files.color import rec709_decode, srgb_decode
from matcap.files.pixels import Pixels, upright
from matcap.photo.hdr_gain_map import HdrGainMap, of_heic, of_jpeg
from matcap.photo.load import load_photo
from matcap.photo.photo import WITH_BRIGHT_GAINS, WITH_GAIN_MAP

LOW, HIGH, GAMMA, BASE_OFFSET, OFFSET = -0.3, 2.2, 1.5, 1 / 64, 1 / 32


@pytest.fixture
def gains() -> np.ndarray:
    """(96, 128) uint8, smooth, without symmetry, from 20 to 220."""
    y, x = np.mgrid[0:96, 0:128]
    return np.rint(20 + 120 * x / 127 + 80 * (y / 95) ** 2).astype(np.uint8)


def expected(base, share, low=LOW, high=HIGH, gamma=GAMMA, offsets=(BASE_OFFSET, OFFSET)):
    """ISO 21496-1, light of base light and of a map's values in [0, 1]."""
    stops = low + (high - low) * share ** (1.0 / np.asarray(gamma))
    return np.maximum((base + offsets[0]) * 2.0**stops - offsets[1], 0.0)


def agrees(pixels, light, tolerance=0.03):
    """Equal within the codes' steps; JPEG decodes to a code or two more or less."""
    error = np.abs(pixels - light) / (light + 0.05)
    return np.median(error) < 0.015 and np.quantile(error, 0.95) < tolerance


NUMBERS = {
    "GainMapMin": LOW, "GainMapMax": HIGH, "Gamma": GAMMA, "OffsetSDR": BASE_OFFSET,
    "OffsetHDR": OFFSET, "HDRCapacityMin": 0, "HDRCapacityMax": 2.2,
}  # fmt: skip
# Longer than the standard says, and with a base offset that is not 0, as iPhones write it.
BLOCK = iso(LOW, HIGH, GAMMA, BASE_OFFSET, OFFSET, more=bytes(60))


@pytest.mark.parametrize("said", [hdrgm(**NUMBERS), BLOCK], ids=["xmp", "iso"])
def test_radiance_follows_the_formula_of_iso_21496(tmp_path, codes, gains, said):
    path = write(tmp_path / "a.jpg", jpeg(codes, [hdrgm()]), jpeg(gains, [said]))
    photo = load_photo(path)
    assert agrees(photo.pixels, expected(srgb_decode(codes / 255.0), gains[..., None] / 255.0))
    assert photo.headroom == pytest.approx((1 + BASE_OFFSET) * 2**HIGH - OFFSET, rel=1e-4)
    assert not photo.clipped.any() and photo.clipped_share == 0.0
    assert "2.2 stops above white" in photo.notes[0]
    assert photo.tone_mapped and photo.development.shoulder == 0.0


@pytest.mark.parametrize(
    ("middle", "prior"), [(0, WITH_BRIGHT_GAINS), (10, WITH_BRIGHT_GAINS), (60, WITH_GAIN_MAP)]
)
def test_a_map_without_gain_for_middle_tones_leaves_these_as_a_phone_s(tmp_path, middle, prior):
    """A code of 10 is 0.08 stops. Darks, and the map's gain of bright tones, do not count."""
    base = np.full((96, 128, 3), 100, np.uint8)
    base[:32], base[:, :32] = 250, 10
    gains = np.where(base[..., 0] == 100, middle, 255).astype(np.uint8)
    path = write(tmp_path / "a.jpg", jpeg(base, [hdrgm()]), jpeg(gains, [hdrgm(GainMapMax=2)]))
    assert load_photo(path).development == prior


def test_each_channel_has_its_own_parameters(tmp_path, codes, gains):
    numbers = NUMBERS | {"GainMapMax": (1.0, 2.0, 3.0), "Gamma": (1.0, 1.2, 2.0)}
    three = np.stack([gains, gains[::-1], gains[:, ::-1]], axis=-1)
    path = write(tmp_path / "a.jpg", jpeg(codes, [hdrgm()]), jpeg(three, [hdrgm(**numbers)]))
    base = srgb_decode(codes / 255.0)
    light = expected(base, three / 255.0, high=np.array((1, 2, 3.0)), gamma=(1.0, 1.2, 2.0))
    assert agrees(load_photo(path).pixels, light)


def test_iso_metadata_override_those_of_apple(tmp_path, codes, gains):
    other = np.full_like(gains, 128)
    path = write(
        tmp_path / "a.jpg",
        jpeg(codes, [hdrgm()]),
        jpeg(other, [apple_xmp(8.0)]),
        jpeg(gains, [BLOCK, apple_xmp(8.0)]),
    )
    light = expected(srgb_decode(codes / 255.0), gains[..., None] / 255.0)
    assert agrees(load_photo(path).pixels, light)


@pytest.mark.parametrize("smaller", [2, 4])
@pytest.mark.parametrize(
    ("note", "headroom"),
    [
        (b"", 4.0),
        (maker_note(0.8, 0.005), 2 ** (1.8 - 20.0 * 0.005)),
        (maker_note(0.8, 0.5), 2 ** (1.601 - 0.101 * 0.5)),
        (maker_note(1.2, 0.005), 2 ** (3.0 - 70.0 * 0.005)),
        (maker_note(1.2, 0.5), 2 ** (2.303 - 0.303 * 0.5)),
    ],
)
def test_a_gain_map_of_apple_is_applied(tmp_path, codes, gains, smaller, note, headroom):
    base = jpeg(codes, exif=exif(note=note))
    small = gains[smaller // 2 :: smaller, smaller // 2 :: smaller]
    path = write(tmp_path / "a.jpg", base, jpeg(small, [apple_xmp(None if note else 4.0)]))
    photo = load_photo(path)
    share = rec709_decode(gains / 255.0)[..., None]
    light = srgb_decode(codes / 255.0) * (1.0 + (headroom - 1.0) * share)
    assert agrees(photo.pixels, light, 0.05) and photo.headroom == pytest.approx(headroom, rel=1e-3)


def test_a_gain_map_of_apple_may_have_a_profile(tmp_path, codes, gains):
    profile = matrix_profile(curve=parametric(0, 1.0), name="linear")
    map_of = jpeg(np.stack([gains] * 3, axis=-1), [apple_xmp(4.0)], icc_profile=profile)
    photo = load_photo(write(tmp_path / "a.jpg", jpeg(codes), map_of))
    light = srgb_decode(codes / 255.0) * (1.0 + 3.0 * gains[..., None] / 255.0)
    assert agrees(photo.pixels, light)


def test_a_base_in_display_p3_keeps_its_colours(tmp_path, codes, gains):
    profile = matrix_profile()
    plain = load_photo(write(tmp_path / "a.jpg", jpeg(codes, icc_profile=profile)))
    base = jpeg(codes, [hdrgm()], icc_profile=profile)
    photo = load_photo(write(tmp_path / "b.jpg", base, jpeg(gains, [iso(0.0, 2.0)])))
    light = expected(plain.pixels, gains[..., None] / 255.0, 0.0, 2.0, 1.0, (0.0, 0.0))
    assert agrees(photo.pixels, light)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_gain_map_is_rotated_with_its_picture(tmp_path, codes, gains, orientation):
    base = jpeg(codes, [hdrgm()], exif=exif(orientation))
    photo = load_photo(write(tmp_path / "a.jpg", base, jpeg(gains[1::2, 1::2], [BLOCK])))
    light = expected(srgb_decode(codes / 255.0), gains[..., None] / 255.0)
    light = upright(light, orientation)
    if orientation > 4:
        light = np.rot90(light)
    assert agrees(photo.pixels, light, 0.05)


def test_light_that_reaches_neither_limit_is_measured(tmp_path, codes, gains):
    codes, gains = codes.copy(), gains.copy()
    codes[16:64, 16:64] = 255
    gains[16:64, 40:64] = 255
    photo = load_photo(write(tmp_path / "a.jpg", jpeg(codes, [hdrgm()]), jpeg(gains, [BLOCK])))
    assert photo.clipped[18:62, 42:62].all()
    assert not photo.clipped[:, :38].any() and not photo.clipped[:, 66:].any()
    assert photo.full[18:62, 42:62].all()


@pytest.mark.parametrize(
    ("pictures", "says"),
    [
        (lambda gains: [], "missing"),
        (lambda gains: [jpeg(gains[:48], [BLOCK])], "another shape"),
        (lambda gains: [jpeg(gains, [apple_xmp()])], "headroom is missing"),
        (lambda gains: [jpeg(gains, [hdrgm(GainMapMax=2, BaseRenditionIsHDR="True")])], "brighter"),
        (lambda gains: [jpeg(gains, [iso(headrooms=(2.0, 0.0))])], "brighter"),
        (lambda gains: [jpeg(gains, [hdrgm()])], "largest gain is missing"),
        (lambda gains: [jpeg(gains, [hdrgm(GainMapMax=2, Gamma=0)])], "damaged"),
        (lambda gains: [jpeg(gains, [hdrgm(GainMapMax=1e9)])], "damaged"),
        (lambda gains: [jpeg(gains, [BLOCK])[:300]], "it is"),
    ],
    ids=["lost", "cropped", "no headroom", "hdr base", "iso hdr base", "no gain", "gamma", "most",
         "cut"],
)  # fmt: skip
def test_a_map_that_cannot_be_used_is_left_out(tmp_path, codes, gains, pictures, says):
    plain = load_photo(write(tmp_path / "a.jpg", jpeg(codes)))
    path = write(tmp_path / "b.jpg", jpeg(codes, [hdrgm()]), *pictures(gains))
    photo = load_photo(path)
    np.testing.assert_array_equal(photo.pixels, plain.pixels)
    assert photo.headroom == 1.0 and "was not applied" in photo.notes[0] and says in photo.notes[0]


def test_damaged_bytes_raise_nothing_else(codes, gains):
    data = bytearray(jpeg(codes, [hdrgm()]) + jpeg(gains, [BLOCK, apple_xmp(4.0)]))
    random = np.random.default_rng(3)
    for _ in range(200):
        broken = bytearray(data)
        for at in random.integers(0, len(data), 8):
            broken[at] = random.integers(256)
        with contextlib.suppress(ValueError):
            of_jpeg(bytes(broken[: random.integers(len(data) // 2, len(data))]), {})


@pytest.mark.parametrize("turned", [False, True])
def test_a_heic_gain_map_of_apple_is_rotated_with_its_base(tmp_path, gains, turned):
    """An auxiliary picture may be handed out as stored; its headroom is in the file's XMP."""
    path = tmp_path / "a.heic"
    path.write_bytes(b"ftyp" + apple_xmp(4.0))
    stored = np.ascontiguousarray(np.rot90(gains, -1)) if turned else gains
    pixels = Pixels(path, np.zeros((96, 128, 3), np.uint8), {}, gain_map=stored)
    gain_map = of_heic(path, pixels)
    np.testing.assert_array_equal(gain_map.codes[..., 0], gains)
    assert gain_map.headroom == pytest.approx(4.0)
    with pytest.raises(ValueError, match="8 bits"):
        of_heic(path, replace(pixels, gain_map=stored.astype(np.uint16)))


@pytest.mark.skipif(importlib.util.find_spec("imagecodecs") is None, reason="needs imagecodecs")
def test_agrees_with_libultrahdr(tmp_path, codes):
    """What libultrahdr encodes from known light, and what it decodes of that."""
    import imagecodecs

    light = np.ones((96, 128, 4), np.float16)
    light[..., :3] = 4.0 * srgb_decode(codes / 255.0) ** 1.5
    path = tmp_path / "a.jpg"
    try:
        path.write_bytes(imagecodecs.ultrahdr_encode(light))
        theirs = imagecodecs.ultrahdr_decode(path.read_bytes()).astype(np.float32)
    except Exception:
        pytest.skip("this imagecodecs has no libultrahdr")
    error = np.abs(load_photo(path).pixels / np.maximum(theirs[..., :3], 1e-3) - 1.0)
    lit = theirs[..., :3].min(axis=2) > 0.02
    # libultrahdr samples its smaller map half a texel aside.
    assert np.median(error[lit]) < 0.01 and np.quantile(error[lit], 0.9) < 0.02


def test_steps_of_a_smooth_map_are_undone_and_its_edges_kept():
    """Codes of a percent of light and more banded glaze; bilinear ones were rounded again."""
    true = np.tile(np.linspace(20.2, 60.7, 64), (48, 1))
    true[20:30, 30:40] += 90.0
    stored = np.rint(true).astype(np.uint8)[..., None]
    gains = np.exp2(4.0 * np.arange(256) / 255.0).astype(np.float32)[:, None]
    none = np.zeros(1, np.float32)
    gain_map = HdrGainMap(stored, gains, none, none)
    base = np.ones((192, 256, 3), np.float32)
    light, full = gain_map.resized(256, 192).light(base, slice(0, 192))
    assert light.shape == base.shape and light.dtype == np.float32 and not full.any()
    codes = 255.0 / 4.0 * np.log2(light[..., 0])
    expected = cv2.resize(true, (256, 192), interpolation=cv2.INTER_LINEAR)
    smooth = np.zeros(codes.shape, bool)
    smooth[16:56, 16:-16] = True
    assert np.abs(codes - expected)[smooth].max() < 0.3
    assert np.abs(codes - expected)[80:120].max() < 0.6

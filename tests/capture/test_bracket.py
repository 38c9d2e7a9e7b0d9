"""Brackets: found by place and exposure, aligned, and merged into one radiance."""

import json
import math
from dataclasses import replace
from fractions import Fraction
from functools import cache

import cv2
import numpy as np
import pytest
from PIL import Image
from simulated.files import mosaic, write_dng

from matcap.capture import bracket
from matcap.capture.bracket import (
    aligned_bracket,
    find_brackets,
    fine_bracket,
    merge_bracket,
    unmerged,
)
from matcap.capture.registration.one_place import alignment, way_of_camera, way_of_highlight
from matcap.capture.run import read_exposures
from matcap.capture.settings import CaptureSettings
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.files.color import srgb_decode, srgb_encode
from matcap.files.settings import Rectangle
from matcap.photo.left_out import shrunk
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo, ToneCurve

WIDTH, HEIGHT, FOV = 640, 480, 66.0
CURVE = ToneCurve(1.3, 0.57)


@cache
def scene(seed: int = 0, peak: float = 8.0) -> np.ndarray:
    """(H, W, 3) float32 light: coloured texture under a flash, its highlight `peak` times white."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    texture = sum(
        cv2.resize(random.standard_normal((HEIGHT // s, WIDTH // s, 1)), (WIDTH, HEIGHT))
        for s in (2, 4, 8, 16)
    )
    squared = ((x - WIDTH / 2) ** 2 + (y - HEIGHT / 2) ** 2) / WIDTH**2
    light = 0.25 * np.exp(0.15 * texture - 2.0 * squared) + peak * np.exp(-squared / 0.002)
    return (light[..., None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)


def taken(light, k=1.0, *, tone=None, raw=False, seed=1, exposure=True, **more) -> Photo:
    """A photograph of light, with noise and clipping."""
    random = np.random.default_rng(seed)
    sensor = k * light
    sensor = sensor + np.sqrt(np.maximum(sensor, 0) / 6000 + 2e-7) * random.standard_normal(
        light.shape
    )
    sensor = np.clip(sensor, 0.0, 1.0).astype(np.float32)
    if not raw:
        code = np.round(255 * srgb_encode((tone or CURVE).developed(sensor).astype(np.float64)))
        sensor = srgb_decode(code / 255.0).astype(np.float32)
    return Photo(
        pixels=sensor,
        clipped=(sensor >= 0.99).any(axis=2),
        fov=FOV,
        fov_source="given",
        radiometric=raw,
        name=f"{k:g}.jpg",
        original_size=(WIDTH, HEIGHT),
        exposure=k if exposure else None,
        **more,
    )


def moved(light, degrees=0.5):
    """Light as a camera sees it that was turned, and the homography to it in units of the width."""
    focal = 0.5 / math.tan(math.radians(FOV) / 2)
    lens = np.array([[focal, 0, 0.5], [0, focal, HEIGHT / WIDTH / 2], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(np.radians([degrees, -0.7 * degrees, 0.4 * degrees]))
    warp = lens @ turn @ np.linalg.inv(lens)
    units, centre = np.diag([WIDTH, WIDTH, 1.0]), np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    pixels = centre @ units @ warp @ np.linalg.inv(centre @ units)
    seen = cv2.warpPerspective(light, pixels, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT_101)
    return np.maximum(seen, 1e-4), warp


def error(photo: Photo, light: np.ndarray) -> np.ndarray:
    """(H, W) absolute log ratio of smoothed luminance to light, up to one factor, inside."""
    a, b = (cv2.GaussianBlur(each.mean(axis=2), (0, 0), 1.5) for each in (photo.pixels, light))
    inner = (np.log(a) - np.log(b))[20:-20, 20:-20]
    return np.abs(inner - np.median(inner))


def test_alignment_finds_the_cameras_turn():
    light = scene()
    other, warp = moved(light)
    first, second = taken(light), taken(other, 1 / 16, seed=2)
    found = alignment(first, second)
    corners = np.array([[0.1, 0.9, 0.1, 0.9], [0.1, 0.1, 0.65, 0.65], [1, 1, 1, 1.0]])
    off = [(each @ corners)[:2] / (each @ corners)[2] for each in (found, warp)]
    assert np.abs(off[0] - off[1]).max() * WIDTH < 0.5
    assert way_of_camera(found, first, second) < 0.005


@pytest.mark.parametrize("stops", [1, 2, 4, 6])
def test_a_bracket_measures_what_one_photograph_clips(stops):
    light = scene(peak=0.6 * 2.0**stops)
    other, _ = moved(light)
    photos = [taken(light), taken(other, 2.0**-stops, seed=2)]
    merged = merge_bracket(photos)
    assert photos[0].clipped.mean() > 0.002 and not merged.clipped[20:-20, 20:-20].any()
    assert not merged.tone_mapped and merged.headroom > 0.9 * 2.0**stops
    off = error(merged, light)
    assert np.median(off) < 0.04 and np.quantile(off, 0.99) < 0.25
    assert "stops darker" in merged.notes[0]


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 1, 0)])
def test_three_exposures_in_any_order(order):
    light = scene(peak=12.0)
    views = [light, moved(light, 0.4)[0], moved(light, -0.3)[0]]
    exposures = [1.0, 1 / 4, 1 / 16]
    photos = [taken(views[k], exposures[k], seed=k) for k in order]
    merged = merge_bracket(photos)
    off = error(merged, views[order[0]])
    assert np.median(off) < 0.05 and merged.clipped.mean() < 0.001


def test_raw_exposures_stay_linear():
    light = scene()
    photos = [taken(light, raw=True), taken(moved(light)[0], 1 / 16, raw=True, seed=2)]
    photos = [replace(photo, noise=0.01 * photo.pixels) for photo in photos]
    merged = merge_bracket(photos)
    assert merged.radiometric and merged.noise is not None
    assert np.quantile(error(merged, light), 0.95) < 0.06


def test_raw_and_jpeg_mix():
    light = scene()
    merged = merge_bracket([taken(light), taken(moved(light)[0], 1 / 16, raw=True, seed=2)])
    assert not merged.radiometric and np.median(error(merged, light)) < 0.05


def test_an_unknown_exposure_is_measured():
    light = scene()
    photos = [taken(light, exposure=False), taken(moved(light)[0], 1 / 16, exposure=False, seed=2)]
    merged = merge_bracket(photos)
    assert merged.headroom == pytest.approx(16.0, rel=0.6)
    assert not merged.clipped[20:-20, 20:-20].any()


def test_what_the_short_exposure_stores_as_black_is_the_long_ones():
    """A value of 0 has no relative error: it must not weigh more than what is measured."""
    light = scene(peak=20.0)
    photos = [taken(light), taken(moved(light)[0], 1 / 64, seed=2)]
    assert (photos[1].pixels == 0.0).mean() > 0.01
    assert (merge_bracket(photos).pixels > 0.3 * light)[20:-20, 20:-20].mean() > 0.999


def test_moved_parts_are_left_out():
    light = scene(peak=2.0)
    other = moved(light)[0].copy()
    other[60:120, 60:160] *= 3.0
    merged = merge_bracket([taken(light), taken(other, 1 / 4, seed=2)])
    assert np.quantile(error(merged, light), 0.99) < 0.25


def glints(shift: int, peak: float) -> np.ndarray:
    """scene() without a highlight but for glints, all moved by so many pixels."""
    light = scene(peak=0.0)
    places = np.random.default_rng(4).integers(40, HEIGHT - 40, (150, 2))
    spots = np.zeros((HEIGHT, WIDTH), np.float32)
    spots[places[:, 0], places[:, 1] + shift] = peak
    return light + 40.0 * cv2.GaussianBlur(spots, (0, 0), 2.5)[..., None]


def test_the_core_of_a_highlight_stands_in_its_flanks():
    """A highlight moves with the camera: only the darker photograph shows its core."""
    light, far = scene(peak=0.0), 8
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]

    def lit(across: float):
        squared = np.square(x - WIDTH / 2 - across) + np.square(y - HEIGHT / 2)
        return (light + 4.0 * np.exp(-squared / 900.0)[..., None]).astype(np.float32)

    bracket = aligned_bracket([taken(lit(0)), taken(lit(far), 1 / 16, seed=2)])
    assert bracket is not None
    brightest = np.maximum(bracket.merged().pixels.mean(axis=2) - 2.0, 0.0)
    assert abs((brightest * x).sum() / brightest.sum() - WIDTH / 2) < 0.5 * far


@pytest.mark.parametrize("way", [(8.0, 0.0), (-3.0, 5.0)])
def test_a_lobe_on_flat_material_is_moved_back_and_its_texture_stays(way):
    """Taken where the darker one shows it, it stood beside its flanks, which are the longer's."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    texture = scene(peak=0.0)

    def lit(across: float, down: float):
        squared = np.square(x - WIDTH / 2 - across) + np.square(y - HEIGHT / 2 - down)
        lobe = 40.0 / np.square(1.0 + squared / 150.0)
        return (texture * (0.5 + lobe[..., None])).astype(np.float32)

    bracket = aligned_bracket([taken(lit(0, 0)), taken(lit(*way), 1 / 16, seed=2)])
    assert bracket is not None
    rows = slice(HEIGHT // 2 - 40, HEIGHT // 2 + 40), slice(WIDTH // 2 - 40, WIDTH // 2 + 40)
    off = []
    for highlight in ((0.0, 0.0), way):
        views = bracket.views[0], replace(bracket.views[1], highlight=highlight)
        merged = replace(bracket, views=views).merged()
        ratio = np.log(merged.pixels.mean(axis=2) / lit(0, 0).mean(axis=2))
        off.append(ratio[rows][~merged.clipped[rows]].std())
    assert off[1] < 0.4 * off[0] and off[1] < 0.12


def test_the_way_of_a_highlight_is_that_of_the_camera():
    """A camera that goes round the sample, and one that turns on its place."""
    photo, focal = taken(scene()), 0.5 / math.tan(math.radians(FOV) / 2)
    lens = np.array([[focal, 0, 0.5], [0, focal, HEIGHT / WIDTH / 2], [0, 0, 1.0]])
    turn, _ = cv2.Rodrigues(np.radians([0.7, -1.5, 0.3]))
    place = np.array([0.012, -0.02, 0.001])
    for moved_by in (place, np.zeros(3)):
        motion = turn - np.outer(turn @ moved_by, [0.0, 0.0, 1.0])
        found = way_of_highlight(lens @ (3.0 * motion) @ np.linalg.inv(lens), photo, photo)
        assert found == pytest.approx(focal * moved_by[:2], abs=1e-3)


@pytest.mark.parametrize("columns", [320, 256, 192])
def test_small_pictures_are_aligned_too(columns):
    """Tiles of 128 pixels were fewer than the ten that must agree."""
    light, size = scene(), (columns, columns * HEIGHT // WIDTH)
    other, warp = moved(light)
    photos = []
    for k, each in enumerate((light, other)):
        photo = taken(each, 1 / 16**k, seed=k + 1)
        pixels = cv2.resize(photo.pixels, size, interpolation=cv2.INTER_AREA)
        photos.append(replace(photo, pixels=pixels, clipped=(pixels > 0.95).any(axis=2)))
    found = alignment(*photos)
    corners = np.array([[0.1, 0.9, 0.1, 0.9], [0.1, 0.1, 0.65, 0.65], [1, 1, 1, 1.0]])
    off = [(each @ corners)[:2] / (each @ corners)[2] for each in (found, warp)]
    assert np.abs(off[0] - off[1]).max() * columns < 0.5
    assert aligned_bracket(photos) is not None


def test_glints_that_moved_keep_their_light():
    """Longer exposures show them clipped, darker ones elsewhere: neither place may lose them."""
    light, other = glints(0, 6.0), glints(6, 6.0)
    bracket = aligned_bracket([taken(light), taken(other, 1 / 16, seed=2)])
    assert bracket is not None
    away = replace(bracket.views[1], way=6.0 / (WIDTH * 0.77))
    merged = replace(bracket, views=(bracket.views[0], away)).merged()
    bright = [np.maximum(each.mean(axis=2) - 1.0, 0.0).sum() for each in (merged.pixels, other)]
    assert bright[0] == pytest.approx(bright[1], rel=0.1)


def test_what_every_exposure_clips_is_as_bright_as_the_darkest_clips():
    light = scene(peak=100.0)
    merged = merge_bracket([taken(light), taken(light, 1 / 16, seed=2)])
    assert merged.clipped.any() and merged.pixels[merged.clipped].mean() > 8.0


def test_a_smooth_material_is_aligned_by_the_whole_picture():
    """A dozen dots: most tiles of the darker picture show noise alone."""
    spots, places = np.zeros((HEIGHT, WIDTH), np.float32), np.random.default_rng(3)
    spots[places.integers(5, HEIGHT - 5, 12), places.integers(5, WIDTH - 5, 12)] = 1.0
    dots = cv2.GaussianBlur(spots, (0, 0), 2.5)
    even = cv2.GaussianBlur(scene(peak=0.0), (0, 0), 40)
    light = even * np.exp(-2.0 * dots / dots.max())[..., None]
    found = alignment(taken(light), taken(light, 1 / 16, seed=2))
    assert found is not None and np.abs(found - np.eye(3)).max() < 0.005


@pytest.mark.parametrize(
    "second",
    [
        lambda light: taken(light, 0.8, seed=2),
        lambda light: taken(scene(5), 1 / 16, seed=2),
        lambda light: taken(
            cv2.warpAffine(light, np.float32([[1.12, 0, -40], [0, 1.12, -30]]), (WIDTH, HEIGHT)),
            1 / 16,
            seed=2,
        ),
        lambda light: taken(np.full_like(light, 0.2), 1 / 8, seed=2),
    ],
    ids=["same exposure", "another sample", "nearer", "other light"],
)
def test_other_photographs_are_no_bracket(second):
    light = scene()
    photos = [taken(light), second(light)]
    assert aligned_bracket(photos) is None
    with pytest.raises(MatcapError, match="same place"):
        merge_bracket(photos)


def test_unlike_photographs_are_left_after_the_shift_alone(monkeypatch):
    fits, fitted = [], cv2.findHomography
    monkeypatch.setattr(cv2, "findHomography", lambda *given: fits.append(0) or fitted(*given))
    assert alignment(taken(scene()), taken(scene(5), 1 / 4, seed=2)) is None
    assert 0 < len(fits) <= 2  # from the shift and from none


def saved(path, photo: Photo, exposure: float | None, camera: str = "phone"):
    """A photograph's pixels as a JPEG with Exif."""
    codes = np.round(255 * srgb_encode(photo.pixels.astype(np.float64))).astype(np.uint8)
    exif = Image.Exif()
    exif.update({271: "maker", 272: camera})
    if exposure is not None:
        exif.get_ifd(34665).update({33434: exposure / 100, 33437: 2.0, 34855: 100, 37385: 1})
    Image.fromarray(codes).save(path, quality=95, exif=exif)
    return path


@pytest.mark.parametrize("stated", [True, False])
def test_brackets_among_files_are_found(tmp_path, stated):
    light, other = scene(), scene(7)
    turned = moved(light)[0]
    shown = [
        (taken(light), 1.0), (taken(turned, 1 / 16, seed=2), 1 / 16),
        (taken(other, seed=3), 1.0), (taken(scene(8), 1 / 2, seed=4), 1 / 2),
    ]  # fmt: skip
    paths = [
        saved(tmp_path / f"{k}.jpg", photo, exposure if stated else None)
        for k, (photo, exposure) in enumerate(shown)
    ]
    found = find_brackets(paths)
    assert found == [(paths[0], paths[1]), (paths[2],), (paths[3],)]
    assert unmerged(found) == [(paths[2], paths[3])] * stated
    assert find_brackets(paths[:1]) == [(paths[0],)]


@pytest.mark.usefixtures("one_coarse_fit")
def test_inspect_judges_what_capture_merges(tmp_path, capsys):
    """And does not ask for the darker photograph that is given."""
    light = scene()
    shown = [(taken(light), 1.0), (taken(light, 1 / 16, seed=2), 1 / 16), (taken(scene(7)), 1.0)]
    paths = [saved(tmp_path / f"{k}.jpg", *each) for k, each in enumerate(shown)]
    assert main(["inspect", *map(str, paths), "--json"]) == 0
    first, other = json.loads(capsys.readouterr().out)["photographs"]
    assert first["photo"] == str(paths[0]) and first["exposures"] == ["0.jpg", "1.jpg"]
    assert other["photo"] == str(paths[2]) and "exposures" not in other
    assert main(["inspect", str(paths[0]), "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)["photographs"][0]
    says = [each["clipped"]["message"] for each in (alone, first)]
    assert says[0] != says[1]
    assert main(["inspect", *map(str, paths[:2])]) == 0
    assert "0.jpg + 1.jpg: " in capsys.readouterr().out


def test_the_curve_is_measured_before_averaging_and_undone_before_it(tmp_path):
    """Means of compressed glints would make the shoulder too strong."""
    fine = cv2.GaussianBlur(np.random.default_rng(2).standard_normal((HEIGHT, WIDTH)), (0, 0), 1.2)
    light = scene() * np.exp(3.0 * fine - 0.3)[..., None].astype(np.float32)
    shown = [(taken(light), 1.0), (taken(light, 1 / 16, seed=2), 1 / 16)]
    paths = [saved(tmp_path / f"{k}.jpg", *each) for k, each in enumerate(shown)]
    fine = fine_bracket(paths, WIDTH)
    tone = fine.curves[0]
    assert abs(tone.shoulder - CURVE.shoulder) < 0.06
    photo = shrunk(fine.views[0].photo, WIDTH // 4, tone)
    again = load_photo(paths[0], long_side=WIDTH // 4, tone=tone)
    assert np.array_equal(photo.pixels, again.pixels) and photo.headroom == again.headroom
    assert np.array_equal(photo.clipped, again.clipped)
    dark = light.max(axis=2) < 0.5
    cells = [cv2.resize(np.where(dark, each, 0), photo.pixels.shape[1::-1],
             interpolation=cv2.INTER_AREA) for each in (light[..., 0], 1.0 * dark)]  # fmt: skip
    whole = cells[1] == 1.0
    assert np.median(photo.pixels[..., 0][whole] / cells[0][whole]) == pytest.approx(1.0, abs=0.06)
    assert not photo.tone_mapped and photo.tone == tone


def test_exposures_are_read_and_aligned_once(tmp_path, monkeypatch):
    """To be found, coarsely, and then for curve, alignment and merging together."""
    counts = dict.fromkeys(("load_photo", "alignment"), 0)

    def counted(name):
        used = getattr(bracket, name)

        def call(*given, **more):
            counts[name] += 1
            return used(*given, **more)

        monkeypatch.setattr(bracket, name, call)

    for name in counts:
        counted(name)
    paths = [
        saved(tmp_path / "a.jpg", taken(scene()), 1.0),
        saved(tmp_path / "b.jpg", taken(moved(scene())[0], 1 / 16, seed=2), 1 / 16),
    ]
    for _ in range(2):
        (group,) = find_brackets(paths)
    assert counts == {"load_photo": 2, "alignment": 1}
    merged = read_exposures(group, CaptureSettings(preset="instant"), several=False)
    assert counts == {"load_photo": 4, "alignment": 2}
    assert merged.headroom == pytest.approx(16.0, rel=0.1) and "merged" in merged.notes[-1]


def written(folder, *, raw: bool):
    """A bracket's files: scene(), and 4 stops darker and turned."""
    paths = []
    for k, (light, exposure) in enumerate([(scene(), 1.0), (moved(scene())[0], 1 / 16)]):
        photo = taken(light, exposure, raw=raw, seed=k)
        if raw:
            exif = {33434: Fraction(exposure) / 60, 33437: Fraction(2), 34855: 100, 37385: 1}
            paths.append(write_dng(folder / f"{k}.dng", mosaic(photo.pixels), exif=exif))
        else:
            paths.append(saved(folder / f"{k}.jpg", photo, exposure))
    return paths


@pytest.mark.parametrize("raw", [False, True])
def test_crop_and_mask_are_left_out_of_what_is_merged(tmp_path, raw):
    """Left out before, it is mirrored, and RAW exposures did not align with it."""
    paths, settings = written(tmp_path, raw=raw), CaptureSettings(preset="instant")
    cropped = replace(settings, crop=Rectangle(40, 300, 480, 150))
    whole, part = (read_exposures(paths, each, several=False) for each in (settings, cropped))
    assert part.left_out is not None and part.headroom == whole.headroom
    assert np.array_equal(part.pixels[~part.left_out], whole.pixels[~part.left_out])
    with pytest.raises(UsageError, match="crop"):
        read_exposures(paths, cropped, several=True)


def test_few_texels_merge_raw_exposures_too(tmp_path):
    """Too few to align by: exposures are aligned at more pixels than they are read at."""
    paths, settings = written(tmp_path, raw=True), CaptureSettings(preset="instant", detail=160)
    merged = read_exposures(paths, settings, several=False)
    assert merged.pixels.shape == (120, 160, 3) and merged.noise is not None
    assert merged.radiometric and merged.headroom == pytest.approx(16.0, rel=0.1)


def test_metadata_decides_before_pixels_do(tmp_path):
    light = scene()
    paths = [
        saved(tmp_path / "a.jpg", taken(light), 1.0),
        saved(tmp_path / "b.jpg", taken(light, 1 / 16, seed=2), 0.9),
        saved(tmp_path / "c.jpg", taken(light, 1 / 16, seed=2), 1 / 16, camera="another"),
    ]
    assert [len(group) for group in find_brackets(paths)] == [1, 1, 1]


def test_unreadable_files_are_no_bracket(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"no picture")
    paths = [tmp_path / "a.jpg", tmp_path / "missing.jpg"]
    assert find_brackets(paths) == [(path,) for path in paths]

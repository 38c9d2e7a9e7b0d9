"""Settings of a batch, and the samples of its input folder."""

import os

import pytest

from matcap.batch.run import group_sentences
from matcap.batch.samples import (
    WORKSPACE,
    BatchSettings,
    find_samples,
    identity,
    settings_of,
    taken_at,
)
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError, UsageError

# matcap.toml and flags; what a material is made from.


def test_flags_override_the_file_and_the_file_defaults(tmp_path):
    (tmp_path / "matcap.toml").write_text(
        'preset = "draft"\ndetail = 512\nsize = "256x128"\ntime = "2m"\npng = true\nfov = 60\n'
    )
    settings = settings_of(tmp_path, {"detail": 256, "preset": None, "png": False})
    capture, outputs = settings.capture, settings.outputs
    assert (capture.preset, capture.detail, outputs.png) == ("draft", 256, False)
    assert (outputs.size, capture.time_limit, capture.fov) == ((256, 128), 120.0, 60.0)
    assert capture.seed == outputs.seed == CaptureSettings().seed


def test_settings_by_name_and_back():
    named = BatchSettings().named() | CHANGES | {"jobs": 2}
    settings = BatchSettings.of(named)
    assert settings.named() == named and settings.capture.seed == settings.outputs.seed == 3
    assert settings.capture.time_limit == 5.0 and settings.outputs.targets == ("gltf",)


def test_the_nearest_settings_file_is_used(tmp_path):
    (tmp_path / "shoot").mkdir()
    (tmp_path / "matcap.toml").write_text("detail = 512\n")
    assert settings_of(tmp_path / "shoot", {}).capture.detail == 512
    (tmp_path / "shoot/matcap.toml").write_text("detail = 256\n")
    assert settings_of(tmp_path / "shoot", {}).capture.detail == 256


def test_a_prior_is_relative_to_the_file(tmp_path):
    (tmp_path / "matcap.toml").write_text('prior = "mine.safetensors"\n')
    assert settings_of(tmp_path, {}).capture.prior == str(tmp_path / "mine.safetensors")
    (tmp_path / "matcap.toml").write_text('prior = "none"\n')
    assert settings_of(tmp_path, {}).capture.prior == "none"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("prest = 'draft'", "'preset'"),
        ("Detail = 512", "'detail'"),
        ("preset = 'drafd'", "'draft'"),
        ("group = 'folder'", "none, name, dir, time"),
        ("detail = '512'", "a whole number"),
        ("detail = true", "a whole number"),
        ("detail = 10", "between 64 and 8192"),
        ("fov = nan", "between 1 and 170"),
        ("size = '12y'", "4096x256"),
        ("size = [1, 2, 3]", "4096x256"),
        ("time = 'soon'", "90s"),
        ("tile = true\nsize = 100", "multiples of 16"),
        ("preset = {a = 1}", "a text"),
        ("seed = ", "not TOML"),
        ("a = " + "[" * 20000, "not TOML"),
    ],
)
def test_a_wrong_setting_is_named_with_the_nearest_known_one(tmp_path, text, word):
    (tmp_path / "matcap.toml").write_text(text)
    with pytest.raises(UsageError) as raised:
        settings_of(tmp_path, {})
    assert word in str(raised.value) and len(str(raised.value)) < 400
    assert raised.value.exit_code == 2


def test_bytes_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "matcap.toml").write_bytes(b"preset = '\xff\xfe'")
    with pytest.raises(UsageError, match="not TOML"):
        settings_of(tmp_path, {})


CHANGES = {
    "maps": "png",
    "metal": False,
    "albedo": 0.2,
    "roughness": 0.3,
    "preset": "draft", "steps": 7, "time": 5.0, "detail": 77, "fov": 30.0, "seed": 3,
    "size": (64, 32), "tile": True, "png": True, "normal": "dx",
    "export": ("gltf",), "generator": "decoder", "aligned": True,
    "width_cm": 20.0, "drawing": False,
}  # fmt: skip


def test_every_setting_that_matters_changes_the_identity(tmp_path):
    photo = tmp_path / "a.jpg"
    photo.write_bytes(b"light")
    base = BatchSettings()
    first = identity([photo], base, prior="p")
    for name, value in CHANGES.items():
        assert identity([photo], BatchSettings.of({name: value}), prior="p") != first, name
    rest = set(base.named()) - set(CHANGES)
    assert rest == {"jobs", "group", "gap", "card", "prior"}
    assert identity([photo], BatchSettings(jobs=3), prior="p") == first


def test_photograph_prior_card_and_version_change_the_identity(tmp_path, monkeypatch):
    photo, base = tmp_path / "a.jpg", BatchSettings()
    photo.write_bytes(b"light")
    first = identity([photo], base, prior="p")
    assert identity([photo], base, prior="q") != first
    assert identity([photo], base, prior="p", card="c") != first
    assert identity([photo, photo], base, prior="p") != first
    photo.rename(tmp_path / "b.jpg")
    assert identity([tmp_path / "b.jpg"], base, prior="p") == first
    with monkeypatch.context() as patch:
        patch.setattr("matcap.batch.samples.MAKER_VERSION", "0")
        assert identity([tmp_path / "b.jpg"], base, prior="p") != first
    (tmp_path / "b.jpg").write_bytes(b"other light")
    assert identity([tmp_path / "b.jpg"], base, prior="p") != first


# Which files of a folder become which materials.


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")


def names(samples):
    return [sample.name for sample in samples]


def test_a_raw_and_its_jpeg_are_one_photograph(tmp_path):
    """JPEGs of browsers, WebP and AVIF are photographs, too."""
    touch(tmp_path, "a.DNG", "A.jpg", "b.jpe", "sub/a.jpg", "notes.txt", "c.heic", "c.nef")
    touch(tmp_path, "d.dng", "d.jfif", "e.webp", "f.avif", "g.AVIF", "g.dng", "h.jfif")
    found = find_samples(tmp_path)
    assert names(found) == [*"abcdefgh", "sub-a"]
    raws = {0: ("a.DNG", "A.jpg"), 2: ("c.nef", "c.heic"), 3: ("d.dng", "d.jfif")}
    for number, (raw, developed) in raws.items():
        assert found[number].photos == (tmp_path / raw,)
        assert found[number].superseded == (tmp_path / developed,)
    assert found[8].superseded == ()


@pytest.mark.parametrize(
    ("raw", "developed"),
    [
        ("PXL_20251115_140015.RAW-02.ORIGINAL.dng", "PXL_20251115_140015.RAW-01.COVER.jpg"),
        ("PXL_20251115_140015.RAW-02.ORIGINAL.dng", "PXL_20251115_140015.RAW-01.MP.COVER.jpg"),
        ("PXL_20251115_140015.dng", "PXL_20251115_140015.MP.jpg"),
        ("PXL_20251115_140015.dng", "PXL_20251115_140015.NIGHT.jpg"),
    ],
)
def test_a_pixel_s_raw_and_its_cover_are_one_photograph(tmp_path, raw, developed):
    touch(tmp_path, raw, developed, "PXL_20251115_140016.MP.jpg", "wall.cover.jpg", "wall.dng")
    found = find_samples(tmp_path)
    assert [(one.photos, one.superseded) for one in found] == [
        ((tmp_path / raw,), (tmp_path / developed,)),
        ((tmp_path / "PXL_20251115_140016.MP.jpg",), ()),
        ((tmp_path / "wall.cover.jpg",), ()),  # no Pixel's name: two photographs
        ((tmp_path / "wall.dng",), ()),
    ]


@pytest.mark.parametrize(
    "folder",
    ["@eaDir/a.jpg", "#recycle", "@Recycle", "__MACOSX", "Thumbnails", "x Previews.lrdata"],
)
def test_folders_of_thumbnails_and_waste_are_passed_over(tmp_path, folder):
    touch(tmp_path, "a.jpg", f"{folder}/SYNOPHOTO_THUMB_XL.jpg", f"sub/{folder}/b.jpg", "sub/c.jpg")
    assert names(find_samples(tmp_path)) == ["a", "sub-c"]


def test_a_developed_picture_is_a_photograph_of_its_own(tmp_path):
    """A TIFF beside a RAW was made by somebody for a reason."""
    touch(tmp_path, "a.dng", "a.tif", "b.png", "b.jpg")
    found = find_samples(tmp_path)
    assert len(found) == 4 and len(set(names(found))) == 4
    assert {sample.photos[0].name for sample in found} == {"a.dng", "a.tif", "b.png", "b.jpg"}


def test_names_are_unique_whatever_the_letters_case_and_stay_when_others_come(tmp_path):
    touch(tmp_path, "x/a.jpg", "x-a.png", "B.jpg", "sub/B.jpg", "report.jpg", ".hidden.jpg")
    before = {sample.photos[0]: sample.name for sample in find_samples(tmp_path)}
    assert len({name.casefold() for name in before.values()}) == len(before) == 5
    assert "report" not in before.values()
    touch(tmp_path, "C.jpg", "sub/D.jpg")
    after = {sample.photos[0]: sample.name for sample in find_samples(tmp_path)}
    assert {photo: after[photo] for photo in before} == before


def test_output_of_batches_hidden_folders_and_links_are_passed_over(tmp_path):
    touch(tmp_path, "a.jpg", "old/b/preview.png", f"old/{WORKSPACE}/x", ".trash/c.jpg")
    touch(tmp_path, "out/d/preview.png")
    os.symlink(tmp_path, tmp_path / "round")
    assert names(find_samples(tmp_path, without=[tmp_path / "out"])) == ["a"]


def test_pictures_that_matcap_wrote_are_passed_over(tmp_path):
    touch(tmp_path, "oak.jpg", "oak.jpg.json", "bark_preview.png", "strip_diffuse.png")
    touch(tmp_path, "strip.json", "strip_preview.png", "strip_normal.png", "sub/preview.png")
    assert names(find_samples(tmp_path)) == ["bark_preview", "oak", "sub-preview"]
    touch(tmp_path, "sub/report.json")
    touch(tmp_path, "strip/maps/strip_substance.json", "strip/maps/strip_base.jpg")
    touch(tmp_path, "game/strip_unreal.json", "game/T_strip_ORM.png", "game/strip.png")
    assert names(find_samples(tmp_path)) == ["bark_preview", "oak", "game-strip"]


def test_grouped_by_folder(tmp_path):
    touch(tmp_path, "one/a.jpg", "one/b.jpg", "two/a.dng", "two/a.jpg", "top.jpg")
    found = find_samples(tmp_path, group="dir")
    assert [len(sample.photos) for sample in found] == [1, 2, 1]
    assert names(found) == [tmp_path.name, "one", "two"]
    assert found[2].superseded == (tmp_path / "two/a.jpg",)


def test_grouped_by_name(tmp_path):
    touch(tmp_path, "oak_2.jpg", "oak_1.jpg", "oak_10.dng", "elm-1.dng", "elm-1.jpg", "elm-2.dng")
    touch(tmp_path, "IMG_0001.jpg", "IMG_0002.jpg", "sub/oak_3.jpg", "ash_4.jpg", "ash_5.jpg")
    groups = [[p.name for p in s.photos] for s in find_samples(tmp_path, group="name")]
    assert ["elm-1.dng", "elm-2.dng"] in groups
    assert ["oak_1.jpg"] in groups  # 1, 2 and 10 are no count
    assert all(len(group) == 1 for group in groups if not group[0].startswith("elm"))
    (tmp_path / "oak_10.dng").unlink()
    groups = [[p.name for p in s.photos] for s in find_samples(tmp_path, group="name")]
    assert ["oak_1.jpg", "oak_2.jpg"] in groups and len(groups) == 7


def test_groups_of_photographs_are_announced(tmp_path):
    touch(tmp_path, "oak_1.jpg", "oak_2.jpg", "elm.jpg")
    said = group_sentences(find_samples(tmp_path, group="name"))
    assert said[0] == "oak_1: 2 photographs of one sample (oak_1.jpg, oak_2.jpg)."
    assert "--group none" in said[-1] and group_sentences(find_samples(tmp_path)) == []


def test_bursts_of_files_are_told_by_their_exif(tmp_path, capfd):
    from PIL import Image

    exif = Image.Exif()
    for name, second in (("c", 1), ("a", 6), ("b", 50), ("d", 13)):
        exif.get_ifd(34665)[36867] = f"2024:05:06 07:08:{second:02}"
        Image.new("RGB", (8, 8)).save(tmp_path / f"{name}.jpg", exif=exif)
    for name in ("e.png", "f.jpg"):
        Image.new("RGB", (8, 8)).save(tmp_path / name)
    assert taken_at(tmp_path / "a.jpg") - taken_at(tmp_path / "c.jpg") == 5.0
    assert taken_at(tmp_path / "f.jpg") is None
    found = find_samples(tmp_path, group="time", gap=8.0)
    groups = [[photo.name for photo in sample.photos] for sample in found]
    assert groups == [["b.jpg"], ["c.jpg", "a.jpg", "d.jpg"], ["e.png"], ["f.jpg"]]
    assert group_sentences(found)[0] == "c: 3 photographs of one sample (c.jpg, a.jpg, d.jpg)."
    # What a file does not say is not the user's to read.
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["nothing", "a.jpg", "empty"])
def test_a_folder_without_photographs_is_refused(tmp_path, name):
    touch(tmp_path, "a.jpg")
    (tmp_path / "empty").mkdir()
    with pytest.raises(MatcapError, match="give a folder"):
        find_samples(tmp_path / name)


@pytest.mark.parametrize("group", ["none", "name"])
def test_exposures_of_one_place_are_one_sample(tmp_path, monkeypatch, group):
    touch(tmp_path, "IMG_0001.jpg", "IMG_0002.jpg", "IMG_0003.jpg", "IMG_0004.jpg", "z.jpg")
    seconds = {"IMG_0001.jpg": 0.0, "IMG_0002.jpg": 2.0, "IMG_0003.jpg": 4.0, "IMG_0004.jpg": 60.0}
    asked = []

    def brackets(paths):
        asked.append([path.name for path in paths])
        return [tuple(paths[:2]), tuple(paths[2:])]

    monkeypatch.setattr("matcap.batch.samples.taken_at", lambda path: seconds.get(path.name))
    monkeypatch.setattr("matcap.capture.bracket.find_brackets", brackets)
    found = find_samples(tmp_path, group=group)
    photos = [[path.name for path in sample.photos] for sample in found]
    assert asked == [["IMG_0001.jpg", "IMG_0002.jpg", "IMG_0003.jpg"]]
    assert photos == [
        ["IMG_0001.jpg", "IMG_0002.jpg"], ["IMG_0003.jpg"], ["IMG_0004.jpg"], ["z.jpg"],
    ]  # fmt: skip

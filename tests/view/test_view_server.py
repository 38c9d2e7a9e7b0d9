"""The server: who gets in, what they get, and what happens to those who ask for something else."""

import json
from functools import cache
from importlib import import_module
from itertools import pairwise
from threading import Event

import numpy as np
import pytest
import torch
from example.exemplars import an_example, blobs, bricks
from materials import a_material
from random_maps import random_maps

from matcap.brdf.cook_torrance import MIN_ROUGHNESS
from matcap.errors import MatcapError
from matcap.example.example import Example
from matcap.field.field import Field
from matcap.field.plane import Rectangle
from matcap.view.document import SCRIPTS, STYLE
from matcap.view.level_of_detail import (
    ExampleLevels,
    ExemplarAverages,
    NetworkLevels,
    edged,
    halved,
    moments_of,
)
from matcap.view.subject import (
    APRON,
    MIPS,
    PAGE_HEIGHT,
    WIDTH,
    EncodedPicture,
    Maps,
    Materials,
    Pages,
    Place,
)

testclient = pytest.importorskip("starlette.testclient", reason="extra 'view' not installed")
pytest.importorskip("uvicorn", reason="extra 'view' not installed")
server = import_module("matcap.view.server")

ADDRESS = server.Address(8123, "secret-token")
BASE = "http://127.0.0.1:8123"
PHOTO = EncodedPicture(b"\x89PNG and so on", "image/png")


@pytest.fixture(scope="module")
def pages(subject):
    one = Pages(subject, workers=1)
    yield one
    one.close()


@pytest.fixture(scope="module")
def client(pages):
    return testclient.TestClient(server.make_app(pages, ADDRESS, PHOTO), base_url=BASE)


def get(client, path, **query):
    return client.get(f"/{ADDRESS.token}/{path}", params=query)


def test_the_page_and_all_its_files_are_served(client):
    page = get(client, "")
    assert page.status_code == 200
    texts = page.text + "".join(get(client, name).text for name in SCRIPTS)
    for name in (*SCRIPTS, STYLE):
        assert f'"{name}"' in texts or f'"./{name}"' in texts
        assert get(client, name).status_code == 200
    assert get(client, "photo").content == PHOTO.data and get(client, "alive").status_code == 204


def test_every_answer_forbids_what_the_page_does_not_need(client):
    for path in ("", "main.js", "page", "nothing"):
        headers = get(client, path).headers
        assert headers["content-security-policy"].startswith("default-src 'none'")
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize(
    "path", ["/", "/main.js", "/page?level=0&column=0&row=0", "/wrong/", "/wrong/page",
             "/secret-token", "/secret-toke/", "/secret-tokenn/", "//secret-token/", "/%00/"]
)  # fmt: skip
def test_without_the_token_nothing_is_given(client, path):
    answer = client.get(BASE + path)
    assert answer.status_code == 403 and "matcap view printed" in answer.text


@pytest.mark.parametrize("host", ["example.com", "127.0.0.1", "127.0.0.1:80", "localhost:9", ""])
def test_another_host_is_refused_even_with_the_token(client, host):
    assert client.get(f"{BASE}/{ADDRESS.token}/", headers={"host": host}).status_code == 421


def test_localhost_is_this_host(client):
    address = f"/{ADDRESS.token}/"
    assert client.get(BASE + address, headers={"host": "localhost:8123"}).status_code == 200


@pytest.mark.parametrize(
    "path", ["../secret", "..%2f..%2fetc%2fpasswd", "%2e%2e/%2e%2e/etc/passwd", "page.html",
             "/etc/passwd", "main.js/../../server.py", "....//main.js", "%2fetc%2fpasswd", "a%00b"]
)  # fmt: skip
def test_no_path_leads_to_a_file(client, path):
    answer = client.get(f"{BASE}/{ADDRESS.token}/{path}")
    assert answer.status_code in (403, 404)
    assert "root:" not in answer.text and "import" not in answer.text


def test_only_get_requests_are_answered(client):
    for method in ("post", "put", "delete", "patch"):
        assert getattr(client, method)(f"/{ADDRESS.token}/page").status_code == 405


@pytest.mark.parametrize(
    ("column", "row", "seed"), [(0, 0, 0), (-3, 2**30, -17), (2**31 - 1, 5, 2)]
)
def test_a_tile_holds_the_texels_of_the_field(client, material, column, row, seed):
    answer = get(client, "page", level=0, column=column, row=row, seed=seed)
    maps = Field(material, seed).read(
        column * WIDTH - APRON, row * PAGE_HEIGHT - APRON,
        WIDTH + 2 * APRON, PAGE_HEIGHT + 2 * APRON, workers=1,
    )  # fmt: skip
    check_texels(levels_of(answer.content)[0], maps)
    about = json.loads(answer.headers["x-page"])
    assert about["texel_size"] == material.texel_size
    assert about["ends"]["height"] == [maps.height.min().item(), maps.height.max().item()]


def levels_of(data):
    """For each level of a page (albedo, surface, relief), channels last."""
    found, at = [], 0
    for mip in range(MIPS):
        shape = ((PAGE_HEIGHT + 2 * APRON) >> mip, (WIDTH + 2 * APRON) >> mip)
        planes = []
        for kind, channels in (("<f2", 4), ("<f4", 4), ("<f4", 1)):
            size = shape[0] * shape[1] * channels * int(kind[-1])
            planes.append(np.frombuffer(data[at : at + size], kind).reshape(*shape, channels))
            at += size
        found.append(planes)
    assert at == len(data)
    return found


def check_texels(found, maps):
    """The finest texels of a page, but for the outermost, are those of maps."""
    albedo, surface, relief = (plane[1:-1, 1:-1].astype(np.float32) for plane in found)
    inner = maps.map(lambda m: m[:, 1:-1, 1:-1])
    wanted = torch.cat([inner.diffuse, inner.specular]).movedim(0, -1).numpy()
    # Half floats of numbers up to 1.
    assert np.abs(albedo - wanted).max() <= 2**-11
    rough = inner.roughness[0].numpy().clip(min=MIN_ROUGHNESS)
    np.testing.assert_allclose(surface[..., 0], rough**4, rtol=1e-4)
    normal = maps.normal[:, 1:-1, 1:-1].numpy()
    np.testing.assert_allclose(surface[..., 1:3], (-normal[:2] / normal[2]).transpose(1, 2, 0),
                               atol=2e-3)  # fmt: skip
    assert not surface[..., 3].any()
    np.testing.assert_allclose(relief[..., 0], inner.height[0].numpy(), atol=1e-5)


def test_a_pages_smaller_levels_are_means(client):
    levels = levels_of(get(client, "page", level=0, column=2, row=1).content)
    for (fine, rough, _), (coarse, faint, _) in pairwise(levels):
        assert np.abs(means(fine.astype(np.float32)) - coarse).max() <= 2**-10
        slopes = rough[..., 1:3]
        np.testing.assert_allclose(faint[..., :3], means(rough)[..., :3], atol=1e-6)
        spread = means((slopes**2).sum(-1) + rough[..., 3]) - (faint[..., 1:3] ** 2).sum(-1)
        np.testing.assert_allclose(faint[..., 3], spread, atol=1e-5)


def means(planes):
    return 0.25 * sum(planes[y::2, x::2] for y in (0, 1) for x in (0, 1))


def test_the_next_level_is_the_mean_of_this_one(client):
    coarse = levels_of(get(client, "page", level=1, column=1, row=1).content)[0]
    fine = levels_of(get(client, "page", level=0, column=2, row=2).content)[0]
    inner = [plane[APRON:-APRON, APRON:-APRON] for plane in fine]
    there = [
        plane[APRON : APRON + PAGE_HEIGHT // 2, APRON : APRON + WIDTH // 2] for plane in coarse
    ]
    assert np.abs(means(inner[0].astype(np.float32)) - there[0]).max() <= 2**-10
    np.testing.assert_allclose(there[1][..., :3], means(inner[1])[..., :3], atol=1e-5)


def test_neighbours_share_what_lies_between_them(client):
    for level in (0, 1, 3, 9):
        left, right = (
            levels_of(get(client, "page", level=level, column=column, row=0).content)[0]
            for column in (4, 5)
        )
        for one, other in zip(left, right, strict=True):
            np.testing.assert_allclose(
                one[:, -2 * APRON :].astype(np.float32),
                other[:, : 2 * APRON].astype(np.float32), atol=1e-5,
            )  # fmt: skip


def test_two_that_cannot_be_blended_can_be_compared(material):
    pair = Materials(material, a_material("other"))
    assert pair.moments(0, Rectangle(0, 0, 8, 8), seed=0, share=1.0)[0].shape[1:] == (8, 8)
    with pytest.raises(MatcapError, match="different shapes"):
        pair.moments(0, Rectangle(0, 0, 8, 8), seed=0, share=0.5)


def test_a_blend_of_exemplars_has_averages_of_its_own():
    spots, wall = (
        a_material(example=Example.of(exemplar)).by("example") for exemplar in (blobs(), bricks())
    )
    pair = Materials(spots, wall)
    first, middle, last = (
        float(pair.moments(6, Rectangle(0, 0, 9, 9), seed=0, share=share)[0][0].mean())
        for share in (0.0, 0.5, 1.0)
    )
    assert middle == pytest.approx((first + last) / 2.0, abs=0.2 * abs(last - first))


def test_the_blend_share_mixes_both_materials(client, subject):
    from matcap.space.between import blend

    found = levels_of(get(client, "page", level=0, column=1, row=1, share=0.25).content)[0]
    between = blend(subject.first, subject.second, 0.25)
    maps = Field(between, 0).read(
        WIDTH - APRON, PAGE_HEIGHT - APRON, WIDTH + 2 * APRON, PAGE_HEIGHT + 2 * APRON
    )
    check_texels(found, maps)


@pytest.mark.parametrize(
    "query",
    [
        {},
        {"level": "0", "column": "0"},
        {"column": "0", "row": "0"},
        {"level": "-1", "column": "0", "row": "0"},
        {"level": "99", "column": "0", "row": "0"},
        {"level": "0", "column": "x", "row": "0"},
        {"level": "0", "column": "1.5", "row": "0"},
        {"level": "0", "column": "0", "row": "0", "seed": "many"},
        {"level": "0", "column": "0", "row": "0", "seed": str(2**70)},
        {"level": "0", "column": "0", "row": "0", "share": "nan"},
        {"level": "0", "column": "0", "row": "0", "share": "1.01"},
        {"column": str(2**32), "row": "0"},
        {"level": "0", "column": "9" * 400, "row": "0"},
        {"level": "0", "column": "9" * 9000, "row": "0"},
    ],
)
def test_bad_parameters_are_one_sentence(client, query):
    answer = get(client, "page", **query)
    assert answer.status_code == 400
    assert answer.text.endswith(".") and "\n" not in answer.text and len(answer.text) < 1000


def test_a_page_is_made_once(subject, monkeypatch):
    calls = watched(monkeypatch, type(subject))
    pages = Pages(subject, workers=2)
    first = [pages.ask(Place(0, 4, 4)), pages.ask(Place(0, 4, 4))]
    assert first[0].result() is first[1].result() and calls == [Place(0, 4, 4).area]
    pages.close()


def watched(monkeypatch, kind):
    """Areas that moments are asked of."""
    read, calls = kind.moments, []
    monkeypatch.setattr(kind, "moments", lambda *a, **k: calls.append(a[2]) or read(*a, **k))
    return calls


def test_abandoned_requests_are_not_computed(subject, monkeypatch):
    read, begun, go = type(subject).moments, Event(), Event()

    def slow(*given, **named):
        begun.set()
        assert go.wait(60)
        return read(*given, **named)

    monkeypatch.setattr(type(subject), "moments", slow)
    pages = Pages(subject, workers=1)
    first, second = pages.ask(Place(0, 0, 0)), pages.ask(Place(0, 1, 0))
    assert begun.wait(60)
    pages.drop(Place(0, 1, 0))
    pages.drop(Place(0, 0, 0))  # too late: it is being made
    go.set()
    assert first.result() and second.cancelled() and pages.ask(Place(0, 1, 0)).result()
    pages.close()


def test_failures_are_not_kept(subject, monkeypatch):
    pages = Pages(subject, workers=1)
    with monkeypatch.context() as broken:
        broken.setattr(type(subject), "moments", lambda *a, **k: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            pages.ask(Place(0, 0, 0)).result()
    assert levels_of(pages.ask(Place(0, 0, 0)).result().data)
    pages.close()


def test_memory_is_bounded(monkeypatch):
    monkeypatch.setattr("matcap.view.subject._KEPT", 3)
    pages = Pages(Maps(random_maps(16, 16), "flat"), workers=1)
    futures = [pages.ask(Place(0, column, 0)) for column in range(9)]
    assert all(future.result() for future in futures) and len(pages._kept) == 3
    pages.close()


def test_map_set_repeats_and_has_one_seed():
    maps = random_maps(50, 30)
    subject = Maps(maps, "bricks")
    found, texel_size = subject.moments(0, Rectangle(-7, 20, 60, 40), seed=0, share=0.0)
    rows, columns = torch.arange(20, 60) % 30, torch.arange(-7, 53) % 50
    assert np.array_equal(found[:4], maps.stacked()[:4, rows][:, :, columns].numpy())
    assert texel_size == maps.texel_size
    with pytest.raises(Exception, match="no other seed"):
        subject.moments(0, Rectangle(0, 0, 8, 8), seed=1, share=0.0)


@pytest.mark.parametrize("level", [1, 2, 3, 5, 8])
def test_map_set_from_afar_is_the_mean_of_what_is_there(level):
    """Sides that are odd soon: 50 and 30 texels."""
    maps = random_maps(50, 30)
    found, _ = Maps(maps, "bricks").moments(level, Rectangle(3, -2, 2, 3), seed=0, share=0.0)
    side = 2**level
    for row in range(3):
        for column in range(2):
            rows = np.arange((row - 2) * side, (row - 1) * side) % 30
            columns = np.arange((column + 3) * side, (column + 4) * side) % 50
            wanted = maps.stacked().double().numpy()[:4, rows][:, :, columns].mean(axis=(1, 2))
            np.testing.assert_allclose(found[:4, row, column], wanted, atol=1e-5)


@pytest.mark.parametrize("level", [2, 3, 4, 6])
def test_far_pages_by_example_look_like_means_of_the_texels(level):
    """As bright, as rough, and of nearly as much contrast; and of the places that are there."""
    example = an_example()
    field = ExampleLevels(example, 7, cache(lambda: ExemplarAverages(example.exemplar)))
    area = Rectangle(-5, 11, *((64, 48) if level < 6 else (32, 24)))
    step = 2**level
    finest = Rectangle(area.x * step, area.y * step, area.width * step, area.height * step)
    truth = moments_of(example.maps(7, finest.grown(1), None), field.texel_size)
    for _ in range(level):
        truth = halved(truth)
    found = field.read(level, area)
    np.testing.assert_allclose(found.mean(axis=(1, 2)), truth.mean(axis=(1, 2)), atol=0.02)
    ratio = found[:5].std(axis=(1, 2)) / truth[:5].std(axis=(1, 2))
    assert ratio.min() > 0.5 and ratio.max() < 2.0
    if level <= 3:  # squares that see something of what they are
        alike = [np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in zip(found, truth, strict=True)]
        assert min(alike[:5]) > 0.4


def test_far_pages_of_a_network_have_its_mean_and_less_and_less_contrast(material):
    field = NetworkLevels.of(material, 3)
    near = field.read(1, Rectangle(0, 0, 256, 256))
    spread = []
    for level in (2, 4, 7, 12):
        found = field.read(level, Rectangle(-100, 70, 256, 128))
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found[:5].mean((1, 2)), near[:5].mean((1, 2)), atol=0.03)
        spread.append(found[:5].std(axis=(1, 2)))
    assert all((b < a).all() for a, b in pairwise([near[:5].std(axis=(1, 2)), *spread]))


def test_slopes_at_an_exemplars_border_are_one_sided():
    stacked = np.random.default_rng(0).random((6, 5, 7), np.float32)
    found = moments_of(edged(stacked), 0.5)
    np.testing.assert_allclose(found[5, 2, 0], (stacked[5, 2, 1] - stacked[5, 2, 0]) / 0.5,
                               rtol=1e-5)  # fmt: skip
    np.testing.assert_allclose(found[6, -1, 3], (stacked[5, -2, 3] - stacked[5, -1, 3]) / 0.5,
                               rtol=1e-5)  # fmt: skip


def test_addresses_cannot_be_guessed():
    tokens = {server.new_address(1).token for _ in range(100)}
    assert len(tokens) == 100 and min(map(len, tokens)) >= 32

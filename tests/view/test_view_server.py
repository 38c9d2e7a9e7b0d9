"""The server: who gets in, what they get, and what happens to those who ask for something else."""

from threading import Barrier

import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.model.field import Field
from matcap.view.block_cache import SIDE, Blocks, Place
from matcap.view.document import SCRIPTS, STYLE
from matcap.view.shown_photograph import EncodedPicture
from matcap.view.subject import Maps

testclient = pytest.importorskip("starlette.testclient", reason="extra 'view' not installed")
server = pytest.importorskip("matcap.view.server")

ADDRESS = server.Address(8123, "secret-token")
BASE = "http://127.0.0.1:8123"
PHOTO = EncodedPicture(b"\x89PNG and so on", "image/png")


@pytest.fixture(scope="module")
def blocks(subject):
    one = Blocks(subject, workers=1)
    yield one
    one.close()


@pytest.fixture(scope="module")
def client(subject, blocks):
    app = server.make_app(subject.facts, blocks, ADDRESS, PHOTO)
    return testclient.TestClient(app, base_url=BASE)


def get(client, path, **query):
    return client.get(f"/{ADDRESS.token}/{path}", params=query)


def test_page_and_all_that_it_names(client):
    page = get(client, "")
    assert page.status_code == 200
    for name in (*SCRIPTS, STYLE):
        assert f'"{name}"' in page.text
        assert get(client, name).status_code == 200
    assert get(client, "photo").content == PHOTO.data


def test_every_answer_forbids_what_the_page_does_not_need(client):
    for path in ("", "main.js", "block", "nothing"):
        headers = get(client, path).headers
        assert headers["content-security-policy"].startswith("default-src 'none'")
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize(
    "path", ["/", "/main.js", "/block?column=0&row=0", "/wrong/", "/wrong/block", "/secret-token",
             "/secret-toke/", "/secret-tokenn/", "//secret-token/", "/%00/"]
)  # fmt: skip
def test_without_the_token_nothing_is_given(client, path):
    answer = client.get(BASE + path)
    assert answer.status_code == 403
    assert "matcap view printed" in answer.text


@pytest.mark.parametrize("host", ["example.com", "127.0.0.1", "127.0.0.1:80", "localhost:9", ""])
def test_another_host_is_refused_even_with_the_token(client, host):
    answer = client.get(f"{BASE}/{ADDRESS.token}/", headers={"host": host})
    assert answer.status_code == 421


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


def test_only_reading(client):
    for method in ("post", "put", "delete", "patch"):
        assert getattr(client, method)(f"/{ADDRESS.token}/block").status_code == 405


@pytest.mark.parametrize(
    ("column", "row", "seed"), [(0, 0, 0), (-3, 2**30, -17), (2**31 - 1, 5, 2)]
)
def test_block_is_the_fields_own_bytes(client, material, column, row, seed):
    answer = get(client, "block", column=column, row=row, seed=seed)
    maps = Field(material, seed).read(column * SIDE, row * SIDE, SIDE, SIDE, workers=1)
    assert answer.content == maps.stacked().numpy().astype("<f4").tobytes()
    assert float(answer.headers["x-texel-size"]) == material.texel_size


def test_share_blends(client, subject):
    from matcap.model.between import blend

    found = np.frombuffer(get(client, "block", column=1, row=1, share=0.25).content, "<f4")
    between = blend(subject.first, subject.second, 0.25)
    maps = Field(between, 0).read(SIDE, SIDE, SIDE, SIDE, workers=1)
    assert np.array_equal(found, maps.stacked().numpy().ravel())


@pytest.mark.parametrize(
    "query",
    [
        {},
        {"column": "0"},
        {"column": "x", "row": "0"},
        {"column": "1.5", "row": "0"},
        {"column": "0", "row": "0", "seed": "many"},
        {"column": "0", "row": "0", "seed": str(2**70)},
        {"column": "0", "row": "0", "share": "nan"},
        {"column": "0", "row": "0", "share": "1.01"},
        {"column": str(2**32), "row": "0"},
        {"column": "9" * 400, "row": "0"},
        {"column": "9" * 9000, "row": "0"},
    ],
)
def test_bad_parameters_are_one_sentence(client, query):
    answer = get(client, "block", **query)
    assert answer.status_code == 400
    assert answer.text.endswith(".") and "\n" not in answer.text and len(answer.text) < 1000


def test_a_block_is_decoded_once(subject, monkeypatch):
    read, calls = type(subject).read, []
    monkeypatch.setattr(
        type(subject), "read", lambda *a, **k: calls.append(a[1:3]) or read(*a, **k)
    )
    blocks = Blocks(subject, workers=2)
    first = [blocks.ask(Place(4, 4)), blocks.ask(Place(4, 4))]
    assert first[0].result() is first[1].result()
    assert sorted(calls) == [(4 * SIDE, 4 * SIDE), (4 * SIDE, 4 * SIDE + SIDE // 2)]
    blocks.close()


def test_a_block_alone_is_decoded_by_all_workers(subject, monkeypatch):
    read, both = type(subject).read, Barrier(2, timeout=60)
    monkeypatch.setattr(type(subject), "read", lambda *a, **k: both.wait() + 1 and read(*a, **k))
    blocks = Blocks(subject, workers=2)
    assert blocks.ask(Place(0, 0)).result()  # or the barrier breaks
    blocks.close()


def test_failures_are_not_kept(subject, monkeypatch):
    blocks = Blocks(subject, workers=1)
    with monkeypatch.context() as broken:
        broken.setattr(type(subject), "read", lambda *a, **k: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            blocks.ask(Place(0, 0)).result()
    assert len(blocks.ask(Place(0, 0)).result().data) == 6 * 4 * SIDE**2
    blocks.close()


def test_memory_is_bounded(monkeypatch):
    monkeypatch.setattr("matcap.view.block_cache._KEPT", 3)
    blocks = Blocks(Maps(flat(16, 16), "flat"), workers=1)
    futures = [blocks.ask(Place(column, 0)) for column in range(9)]
    assert all(future.result() for future in futures)
    assert len(blocks._kept) == 3
    blocks.close()


def test_map_set_repeats_and_has_one_seed():
    maps = flat(48, 32)
    subject = Maps(maps, "bricks")
    read = subject.read(-7, 30, 60, 40, seed=0, share=0.0).stacked()
    rows, columns = torch.arange(30, 70) % 32, torch.arange(-7, 53) % 48
    assert torch.equal(read, maps.stacked()[:, rows][:, :, columns])
    with pytest.raises(Exception, match="no other seed"):
        subject.read(0, 0, 8, 8, seed=1, share=0.0)


def test_addresses_cannot_be_guessed():
    tokens = {server.new_address(1).token for _ in range(100)}
    assert len(tokens) == 100 and min(map(len, tokens)) >= 32


def flat(width, height):
    generator = torch.Generator().manual_seed(1)
    return MapSet.from_stacked(torch.rand(6, height, width, generator=generator), 2 / 512)

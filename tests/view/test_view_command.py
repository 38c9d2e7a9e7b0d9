"""`matcap view` on the command line, and the page as one file."""

import base64
import json
import re
import signal
import socket
import subprocess
import sys
import urllib.request
import zlib
from dataclasses import replace

import numpy as np
import pytest

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.view.document import sealed_page
from matcap.view.subject import Maps, Materials, find_photograph, open_subject, reported_photograph


@pytest.fixture(scope="module")
def folder(material, tmp_path_factory):
    """What a capture leaves, as far as the page is concerned."""
    folder = tmp_path_factory.mktemp("view") / "leather"
    folder.mkdir()
    material.save(folder / "leather.matcap")
    write_mapset(material.maps(64, 48), folder, MapSetInfo("leather"))
    return folder


def about_of(page: str) -> dict:
    return json.loads(
        re.search(r'<script type="application/json" id="about">(.*?)</script>', page)[1]
    )


def test_a_material_is_preferred_to_its_maps(folder, tmp_path, material):
    assert isinstance(open_subject(folder), Materials)
    assert isinstance(open_subject(folder / "leather.matcap", seed=3), Materials)
    write_mapset(material.maps(64, 48), tmp_path, MapSetInfo("bricks"))
    subject = open_subject(tmp_path)
    assert isinstance(subject, Maps) and subject.facts.period == (64, 48)


@pytest.mark.parametrize("extra", [{"seed": 4}, {"second": "x.matcap"}])
def test_a_map_set_has_no_seed_and_no_blend(tmp_path, material, extra):
    write_mapset(material.maps(64, 48), tmp_path, MapSetInfo("bricks"))
    with pytest.raises(UsageError, match="give the .matcap file"):
        open_subject(tmp_path, **extra)


def test_the_photograph_that_the_report_tells_of(tmp_path):
    shot = tmp_path / "shoot" / "leather.dng"
    report = {"photograph": {"path": str(shot)}}
    assert reported_photograph({}) is reported_photograph(report) is None  # untold, or gone
    shot.parent.mkdir()
    shot.touch()
    assert reported_photograph(report) == shot


def test_photograph_of_the_folder(folder, tmp_path):
    assert find_photograph(tmp_path, "leather") is None
    (tmp_path / "preview.png").touch()  # a sheet of many panels, which nobody can read
    assert find_photograph(tmp_path, "leather") is None
    for name in ("photo.jpg", "leather.dng"):
        (tmp_path / name).touch()
        assert find_photograph(tmp_path, "leather") == tmp_path / name
        assert find_photograph(tmp_path / "leather.matcap", "leather") == tmp_path / name


def test_html_is_one_sealed_file(folder, tmp_path, material, capsys):
    page = tmp_path / "page.html"
    assert main(["view", str(folder), "--html", str(page), "--tile", "64", "--seed", "2"]) == 0
    assert "wrote" in capsys.readouterr().err
    text = page.read_text(encoding="utf-8")
    # No address of anything else, and a policy that would not let it be fetched.
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)
    assert not re.search(r"https?://", text) and "default-src 'none'" in text
    tile = about_of(text)["tile"]
    assert tile["size"] == [64, 64]
    split = np.frombuffer(zlib.decompress(base64.b64decode(tile["data"])), np.uint8)
    words = np.ascontiguousarray(split.reshape(2, -1).T).view("<u2").ravel()
    wanted = material.maps(64, 64, seed=2, period=(64, 64)).stacked().numpy()
    found = words[: 5 * 64 * 64].view("<f2").reshape(5, 64, 64)
    assert np.array_equal(found[4], wanted[4].astype("<f2"))
    np.testing.assert_allclose(found[:4], wanted[:4], rtol=2**-9 + 2**-11)
    height = tile["low"] + words[5 * 64 * 64 :] / 65535 * tile["span"]
    assert np.abs(height - wanted[5].ravel()).max() <= tile["span"] / 65535


def test_maps_that_half_floats_cannot_hold_are_said(material):
    maps = material.maps(16, 16)
    bright = replace(maps, diffuse=maps.diffuse + 70000.0)
    with pytest.raises(MatcapError, match="too large for half float"):
        sealed_page(Maps(bright, "bright"))


def test_names_cannot_break_out_of_the_page(material):
    evil = '</script><script>alert(1)</script>"&'
    page = sealed_page(Maps(material.maps(16, 16), evil))
    assert "<script>alert" not in page and about_of(page)["name"] == evil


@pytest.mark.parametrize(
    ("arguments", "says", "code"),
    [
        (["nowhere"], "no such file or folder", 3),
        (["{folder}", "--html", "page.txt"], "use .html or .htm", 2),
        (["{folder}", "--html", "{out}/page.html", "--tile", "65"], "choose a multiple of 16", 2),
        (["{folder}", "--html", "/proc/page.html"], "matcap: /proc: ", 3),
        (["{folder}", "--html", "/proc/page.html"], "choose another folder with --html.", 3),
        (["{folder}", "--blend", "nowhere.matcap"], "no such file", 3),
        (["{folder}", "--photo", "nowhere.jpg"], "nowhere.jpg", 3),
    ],
)
def test_wrong_arguments_are_one_sentence(folder, tmp_path, capsys, arguments, says, code):
    given = [part.format(folder=folder, out=tmp_path) for part in arguments]
    assert main(["view", *given, "--no-open"]) == code
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1 and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("asked", [["--seed", str(2**70)], ["--tile", "999984"]])
def test_what_is_out_of_range_is_a_usage_error(folder, capsys, asked):
    assert main(["view", str(folder), *asked, "--no-open"]) == 2
    assert asked[0] in capsys.readouterr().err


def test_a_port_in_use_is_reported(folder, capsys):
    pytest.importorskip("uvicorn", reason="the extra 'view' is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["view", str(folder), "--no-open", "--port", str(port)]) == 3
    assert f"the port {port} cannot be used" in capsys.readouterr().err


def test_a_missing_extra_names_its_install_command(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matcap.view.server", None)
    assert main(["view", str(folder), "--no-open"]) == 3
    assert 'pip install "matcap[view]"' in capsys.readouterr().err


def test_the_command_serves_until_it_is_interrupted(folder):
    pytest.importorskip("uvicorn", reason="the extra 'view' is not installed")
    start = "from matcap.cli.main import run; run()"
    command = [sys.executable, "-c", start, "view", str(folder), "--no-open", "-q"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as one:
        try:
            address = one.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", address)
            with urllib.request.urlopen(address, timeout=30) as answer:
                assert "<canvas" in answer.read().decode()
            one.send_signal(signal.SIGINT)
            assert one.wait(30) == 0 and one.stderr.read() == ""
        finally:
            one.kill()

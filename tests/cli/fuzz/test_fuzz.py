"""Spoilt files of every kind; fuzz.py does it by the ten thousand."""

import json
import struct

import pytest
from fuzz import fuzz
from inputs import forged, write_material

from matcap.errors import MatcapError
from matcap.field.material import Material


def test_no_spoilt_file_is_more_than_an_error_message(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tally, faults = fuzz(tmp_path / "good", count=150, seed=11)
    assert not faults, "\n".join(faults)
    # As long as some inputs are still good and most are not, the readers are looked at in depth.
    assert tally["good"] > 10 and tally["refused"] > 50


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Bytes of an untrained material's file."""
    path = tmp_path_factory.mktemp("small") / "a.matcap"
    write_material(path)
    return path.read_bytes()


@pytest.fixture
def path(tmp_path, small):
    """That file."""
    path = tmp_path / "a.matcap"
    path.write_bytes(small)
    return path


def described(path, change):
    """Change the description of a .matcap file; its container stays right."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"]["matcap"])
    change(about)
    header["__metadata__"]["matcap"] = json.dumps(about)
    # With a digest that is right, or it would be called damaged for that alone.
    text = json.dumps(forged(header, data[8 + length :])).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("../../etc/passwd", "_.._etc_passwd"),
        ("a\0b\nc", "a_b_c"),
        ("", "material"),
        ("...", "material"),
        ("Leather (2), brown", "Leather (2), brown"),
        ("x" * 5000, "x" * 100),
    ],
)
def test_a_material_has_a_plain_name(path, name, plain):
    described(path, lambda about: about.update(name=name))
    assert Material.load(path).name == plain


def test_a_hostile_file_cannot_claim_memory(path):
    """The widest decoder that single widths allow would take gigabytes: refused before any."""

    def widen(about):
        about["decoder"].update(noise_channels=1024, widths=[1024] * 5, convolutions=[4, 4])

    described(path, widen)
    import resource

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(MatcapError, match="weights"):
        Material.load(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kilobytes


@pytest.mark.parametrize(
    "change",
    [
        lambda about: about.update(texel_size=float("nan")),
        lambda about: about.update(texel_size=0.0),
        lambda about: about["setup"].update(fov=180.0),
        lambda about: about["setup"].update(tilt=[0.0, float("inf")]),
        lambda about: about["waves"][0].update(fx=1e300),
        lambda about: about["decoder"].update(widths=[4, 4]),
        lambda about: about["decoder"].update(cells=65),
        lambda about: about["decoder"].update(cells=-1),
        lambda about: about.update(provenance=3),
        lambda about: about.update(setup=10**400),
    ],
)
def test_numbers_out_of_range_are_refused(path, change):
    described(path, change)
    with pytest.raises(MatcapError, match="description is damaged"):
        Material.load(path)

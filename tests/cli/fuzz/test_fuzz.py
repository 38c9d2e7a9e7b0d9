"""Spoilt files of every kind; fuzz.py does it by the ten thousand."""

import json
import struct

import pytest
from fuzz import fuzz
from inputs import forged, write_material

from matcap.errors import MatcapError
from matcap.field.material import Material


def test_no_spoilt_file_is_more_than_an_error_message(tmp_path):
    tally, faults = fuzz(tmp_path, count=340, seed=11)
    result = [f"{fault.number} ({fault.kind}): {fault.what}" for fault in faults]
    assert not faults, "\n".join(result)
    # As long as some inputs are still good and most are not, the readers are looked at in depth.
    assert tally["good"] > 20 and tally["refused"] > 100


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
def test_a_material_has_a_plain_name(tmp_path, name, plain):
    path = tmp_path / "a.matcap"
    write_material(path)
    described(path, lambda about: about.update(name=name))
    assert Material.load(path).name == plain


def test_a_hostile_file_cannot_claim_memory(tmp_path, monkeypatch):
    """The widest decoder that single widths allow would take gigabytes: refused before any."""
    path = tmp_path / "a.matcap"
    write_material(path)

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
def test_numbers_out_of_range_are_refused(tmp_path, change):
    path = tmp_path / "a.matcap"
    write_material(path)
    described(path, change)
    with pytest.raises(MatcapError, match="description is damaged"):
        Material.load(path)

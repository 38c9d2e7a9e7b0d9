"""The corpus: a folder with bad pictures, the pack's file, and the rule of holding out."""

import numpy as np
import pytest
import torch

from matcap.errors import MatcapError
from matcap_lab.simulate.kinds import RandomKind
from matcap_lab.train.corpus import Pack, build, held_out, material_of, simulate


def test_unreadable_pictures_are_listed_and_left_out(pack, tmp_path):
    (tmp_path / "a_1.jpg").write_bytes(pack.entries[0].jpeg)
    (tmp_path / "b_1.jpg").write_bytes(b"not a picture")
    (tmp_path / "c_1.jpg").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("no picture either")
    packed, skipped = build(tmp_path, 0)
    assert [e.material for e in packed.entries] == ["a"]
    assert [name for name, _ in skipped] == ["b_1.jpg", "c_1.jpg"]


def test_a_folder_without_pictures_is_an_error(tmp_path):
    with pytest.raises(MatcapError, match="no picture could be used"):
        build(tmp_path, 0)
    with pytest.raises(MatcapError, match="no such folder"):
        build(tmp_path / "absent", 0)


def test_a_pack_comes_back(pack, tmp_path):
    path = tmp_path / "corpus.pack"
    pack.save(path)
    again = Pack.load(path)
    for found, wanted in zip(again.entries, pack.entries, strict=True):
        assert (found.name, found.jpeg, found.coarse) == (wanted.name, wanted.jpeg, wanted.coarse)
        assert (found.waves, found.tilt, found.simulated) == (
            wanted.waves,
            wanted.tilt,
            wanted.simulated,
        )
    assert again.reserved == pack.reserved


def test_what_is_no_pack_is_refused(tmp_path):
    path = tmp_path / "pack"
    with pytest.raises(MatcapError, match="no such pack"):
        Pack.load(path)
    path.write_bytes(b"\0" * 64)
    with pytest.raises(MatcapError, match="cannot be read"):
        Pack.load(path)
    from safetensors.torch import save_file

    save_file({"x": torch.zeros(1)}, path)
    with pytest.raises(MatcapError, match="not a pack of version"):
        Pack.load(path)


def test_holding_out_depends_on_names_alone():
    names = [f"{n:04d}" for n in range(77)]
    chosen = held_out(names)
    assert len(chosen) == 12
    assert chosen == held_out(list(reversed(names)) + names)
    # Leaving out a material that was not chosen changes nothing.
    rest = [n for n in names if n in chosen or n != max(set(names) - chosen)]
    assert held_out(rest) == chosen


def test_simulated_photographs_show_things_and_patterns():
    drawn = [material_of(seed, np.random.default_rng(seed)) for seed in range(40)]
    things = [m for m in drawn if isinstance(m, RandomKind)]
    assert 16 < len(things) < 32
    assert len({m.kind for m in things}) > 10


def test_a_simulated_photograph_knows_its_tilt():
    entry = simulate(3)
    assert entry.simulated and entry.tilt is not None
    assert np.abs(entry.tilt).max() < np.radians(15.1)
    assert entry.photo().pixels.shape == (768, 1024, 3)

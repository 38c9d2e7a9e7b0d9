"""Tensors in a file: whole, and for whoever the folder is for."""

import os
import stat
from unittest.mock import ANY

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from matcap.errors import MatcapError
from matcap.files.digest import digest_matches
from matcap.files.tensors import write_tensors


def test_tensors_and_their_text_come_back(tmp_path):
    path = tmp_path / "new" / "a.safetensors"
    transposed = torch.arange(6.0).reshape(2, 3).T
    write_tensors(path, {"a": transposed, "b": torch.tensor([True])}, {"about": "x"})
    with safe_open(path, framework="pt") as file:
        assert file.metadata() == {"about": "x", "digest": ANY}
        assert torch.equal(file.get_tensor("a"), transposed)
        assert torch.equal(file.get_tensor("b"), torch.tensor([True]))
    assert [f.name for f in path.parent.iterdir()] == ["a.safetensors"]


def test_the_file_is_as_readable_as_any_other(tmp_path):
    old = os.umask(0o022)
    try:
        write_tensors(tmp_path / "a.safetensors", {"a": torch.zeros(1)}, {})
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a.safetensors").stat().st_mode) == 0o644


def test_half_floats_that_have_overflowed_are_said(tmp_path):
    large = torch.tensor([1.0, 70000.0])
    write_tensors(tmp_path / "whole", {"a": large}, {})
    with pytest.raises(MatcapError, match="b has values too large for half float"):
        write_tensors(tmp_path / "half", {"a": large, "b": large.half()}, {})
    assert [file.name for file in tmp_path.iterdir()] == ["whole"]


def whole(path):
    with safe_open(path, framework="pt") as file:
        return digest_matches(path, file.metadata())


@pytest.mark.parametrize("place", [-1, -100, -400])
def test_one_flipped_bit_in_a_tensor_is_noticed(tmp_path, place):
    path = tmp_path / "a.safetensors"
    write_tensors(path, {"a": torch.arange(100.0), "b": torch.ones(1)}, {"about": "x"})
    assert whole(path)
    written = bytearray(path.read_bytes())
    written[place] ^= 1
    path.write_bytes(written)
    assert not whole(path)


def test_a_changed_text_is_noticed(tmp_path):
    path = tmp_path / "a.safetensors"
    write_tensors(path, {"a": torch.zeros(3)}, {"about": "size 1"})
    path.write_bytes(path.read_bytes().replace(b"size 1", b"size 7"))
    assert not whole(path)


def test_a_file_without_a_digest_is_not_whole(tmp_path):
    save_file({"a": torch.zeros(3)}, tmp_path / "old.safetensors", {"about": "x"})
    assert not whole(tmp_path / "old.safetensors")

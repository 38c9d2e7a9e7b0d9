"""Results are kept as they are made, and not made again."""

from dataclasses import replace

import pytest
import torch

from matcap.errors import MatcapError
from matcap.lab.train.kept import key_of, once, photograph_key, prior_key
from matcap.lab.train.measure import Result


def result(style: float = 0.5) -> Result:
    picture = torch.linspace(0.0, 1.0, 3 * 8 * 8).reshape(3, 8, 8)
    return Result("m0", "prior, 2 steps", style, 0.1, 1.2, 3.5, picture)


def numbers(of: Result) -> dict[str, object]:
    return {name: value for name, value in vars(of).items() if name != "picture"}


def never() -> Result:
    raise AssertionError("it was kept")


def test_what_is_kept_is_not_made_again(tmp_path):
    made = once(tmp_path / "kept", "a", result)
    again = once(tmp_path / "kept", "a", never)
    assert numbers(again) == numbers(made)
    torch.testing.assert_close(again.picture, made.picture, rtol=0.0, atol=0.5 / 255.0)


def test_every_key_has_its_own_result(tmp_path):
    once(tmp_path, "a", lambda: result(0.1))
    once(tmp_path, "b", lambda: result(0.2))
    assert [once(tmp_path, key, never).style for key in "ab"] == [0.1, 0.2]


def test_a_torn_line_is_made_again_and_harms_no_other(tmp_path):
    once(tmp_path, "a", result)
    once(tmp_path, "b", result)
    table = tmp_path / "results.jsonl"
    table.write_bytes(table.read_bytes()[:-20])  # killed while writing b's
    assert once(tmp_path, "b", lambda: result(0.9)).style == 0.9
    assert once(tmp_path, "a", never).style == 0.5
    assert once(tmp_path, "b", never).style == 0.9


def test_a_result_without_its_picture_is_made_again(tmp_path):
    once(tmp_path, "a", result)
    (tmp_path / "a.png").unlink()
    assert once(tmp_path, "a", lambda: result(0.9)).style == 0.9
    assert once(tmp_path, "a", never).style == 0.9


def test_a_folder_that_cannot_be_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MatcapError, match="cannot be kept"):
        once(tmp_path / "file", "a", result)


def test_keys_tell_apart_what_results_follow_from(prior, pack):
    assert key_of("a", "bc") != key_of("ab", "c")
    assert key_of("a", 1) == key_of("a", 1)
    first, second = pack.entries[:2]
    straight = replace(first, coarse=replace(first.coarse, roughness=0.61))
    assert len({photograph_key(e) for e in (first, second, straight)}) == 3
    before = prior_key(prior)
    with torch.no_grad():
        prior.decoder.head.convolution.weight[0, 0] += 1e-3
    assert prior_key(prior) != before

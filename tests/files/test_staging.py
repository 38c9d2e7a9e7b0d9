"""All files or none, and one sentence when none."""

import errno
import os
from pathlib import Path

import pytest

from matcap.errors import ExitCode, MatcapError
from matcap.files.staging import check_writable, staged, staged_file


def test_files_appear_together_in_a_new_folder(tmp_path):
    folder = tmp_path / "a" / "b"
    with staged(folder) as stage:
        (stage / "one.txt").write_text("1")
        (stage / "two.json").write_text("2")
        assert not (folder / "one.txt").exists()
    assert sorted(f.name for f in folder.iterdir()) == ["one.txt", "two.json"]


def test_a_failure_leaves_nothing_not_even_folders(tmp_path):
    with pytest.raises(ZeroDivisionError), staged(tmp_path / "a" / "b") as stage:
        (stage / "one.txt").write_text("1")
        _ = 1 / 0
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), staged(tmp_path / "a") as stage:
        (stage / "one.txt").write_text("1")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_failure_keeps_what_was_there(tmp_path):
    (tmp_path / "one.txt").write_text("old")
    with pytest.raises(MatcapError), staged(tmp_path, replacing=["one.txt"]) as stage:
        (stage / "one.txt").write_text("new")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert [f.name for f in tmp_path.iterdir()] == ["one.txt"]
    assert (tmp_path / "one.txt").read_text() == "old"


def test_replaced_files_go_with_the_old_set(tmp_path):
    for name in ("old.png", "kept.png", "both.png"):
        (tmp_path / name).write_text("old")
    with staged(tmp_path, replacing=["old.png", "both.png"]) as stage:
        (stage / "both.png").write_text("new")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["both.png", "kept.png"]
    assert (tmp_path / "both.png").read_text() == "new"


def test_a_single_file_is_replaced_when_it_is_whole(tmp_path):
    path = tmp_path / "a" / "one.txt"
    with staged_file(path) as file:
        file.write_text("old")
    with pytest.raises(ZeroDivisionError), staged_file(path) as file:
        file.write_text("new")
        _ = 1 / 0
    assert [f.name for f in path.parent.iterdir()] == ["one.txt"]
    assert path.read_text() == "old"


def test_the_file_that_cannot_take_its_place_is_named(tmp_path):
    (tmp_path / "taken").mkdir()
    with (
        pytest.raises(MatcapError, match=r"taken: a folder stands where a file is needed"),
        staged_file(tmp_path / "taken") as file,
    ):
        file.write_text("1")
    assert [f.name for f in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "the disk is full; free some space"),
        (errno.EACCES, "no permission"),
        (errno.EROFS, "read-only"),
        (errno.EIO, "could not be written"),
    ],
)
def test_each_cause_is_one_sentence_with_a_remedy(tmp_path, number, said):
    with pytest.raises(MatcapError, match=said) as caught, staged(tmp_path / "a"):
        raise OSError(number, os.strerror(number))
    assert str(tmp_path / "a") in str(caught.value)
    assert "-o" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == ExitCode.NOTHING_SUCCEEDED
    assert isinstance(caught.value.__cause__, OSError)


def test_a_file_where_the_folder_should_be(tmp_path):
    (tmp_path / "a").write_text("a file")
    for folder in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(MatcapError, match="a file stands"), staged(folder):
            pass
        with pytest.raises(MatcapError, match="a file stands"):
            check_writable(folder, 1)


def test_check_writable_leaves_nothing(tmp_path):
    check_writable(tmp_path / "a" / "b", 1000)
    assert list(tmp_path.iterdir()) == []


def test_check_writable_keeps_an_existing_folder(tmp_path):
    (tmp_path / "a").mkdir()
    check_writable(tmp_path / "a" / "b", 1000)
    assert [f.name for f in tmp_path.iterdir()] == ["a"]


def test_too_little_room_is_told_with_both_sizes(tmp_path):
    with pytest.raises(MatcapError, match=r"1e\+03 PB|1000 PB") as caught:
        check_writable(tmp_path / "a", 10**18)
    assert "left" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(MatcapError, match="no permission"):
            check_writable(tmp_path / "a", 1)
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.skipif(not Path("/proc/version").exists(), reason="no file system to refuse us")
def test_a_file_system_that_takes_no_folders():
    with pytest.raises(MatcapError, match="choose another folder"):
        check_writable(Path("/proc/matcap"), 1)

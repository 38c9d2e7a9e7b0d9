"""Outputs appear together or not at all, and replace nothing that nobody asked to replace."""

import errno
import os
from pathlib import Path

import pytest

from matcap.errors import ExitCode, MatcapError, UsageError
from matcap.files.output import Output, check_output, check_writable


def contents(folder):
    """Text by name of all files in a folder, hidden ones included."""
    return {file.name: file.read_text() for file in folder.iterdir()}


def write(folder, text):
    """Three files, one of which replaces an older one that has another name."""
    with Output(folder, ["old"]).stage() as stage:
        for name in ("a", "b.json", "c"):
            (stage / name).write_text(text)


def test_files_appear_together_in_a_new_folder(tmp_path):
    folder = tmp_path / "a" / "b"
    with Output(folder).stage() as stage:
        (stage / "one.txt").write_text("1")
        (stage / "two.json").write_text("2")
        assert not (folder / "one.txt").exists()
    assert contents(folder) == {"one.txt": "1", "two.json": "2"}


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_a_failure_leaves_no_file_and_no_new_folder(tmp_path, error):
    with pytest.raises(error), Output(tmp_path / "a" / "b").stage() as stage:
        (stage / "one.txt").write_text("1")
        raise error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [OSError(errno.EIO, "broken"), KeyboardInterrupt()], ids=repr)
@pytest.mark.parametrize("made", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("at", range(6))
def test_an_interrupted_rename_restores_all_old_files(tmp_path, monkeypatch, at, made, error):
    """Six renames: three old files away, three new ones in."""
    before = {"a": "old", "old": "old", "b.json": "old"}
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    replace, steps = os.replace, []

    def fails(start, end):
        steps.append(start)
        if len(steps) != at + 1:
            return replace(start, end)
        if made:
            replace(start, end)
        raise error

    monkeypatch.setattr(os, "replace", fails)
    with pytest.raises((MatcapError, KeyboardInterrupt)):
        write(tmp_path, "new")
    assert contents(tmp_path) == before


def test_new_files_replace_the_old_ones_and_documents_come_last(tmp_path, monkeypatch):
    moved, replace = [], os.replace
    monkeypatch.setattr(os, "replace", lambda *a: (moved.append(Path(a[1]).name), replace(*a)))
    for name in ("old", "kept"):
        (tmp_path / name).write_text("old")
    write(tmp_path, "new")
    assert contents(tmp_path) == {"a": "new", "b.json": "new", "c": "new", "kept": "old"}
    assert moved[-3:] == ["a", "c", "b.json"]


def test_a_single_file_is_replaced_when_it_is_whole(tmp_path):
    path = tmp_path / "a" / "one.txt"
    with Output.file(path) as file:
        file.write_text("old")
    with pytest.raises(ZeroDivisionError), Output.file(path) as file:
        file.write_text("new")
        _ = 1 / 0
    assert contents(path.parent) == {"one.txt": "old"}


@pytest.mark.parametrize("name", ["a", "old"])
def test_a_folder_in_the_place_of_a_file_is_named_and_nothing_is_written(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(MatcapError, match=rf"{name}: a folder stands where a file is needed"):
        write(tmp_path, "new")
    with pytest.raises(MatcapError, match=rf"{name}: a folder stands"):
        check_writable(tmp_path, 1, ["a", "old"])
    assert os.listdir(tmp_path) == [name]


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
    with pytest.raises(MatcapError, match=said) as caught, Output(tmp_path / "a").stage():
        raise OSError(number, os.strerror(number))
    assert str(tmp_path / "a") in str(caught.value)
    assert "-o" in str(caught.value) and "\n" not in str(caught.value)
    assert caught.value.exit_code == ExitCode.NOTHING_SUCCEEDED
    assert isinstance(caught.value.__cause__, OSError)


def test_a_file_where_the_folder_should_be_is_refused(tmp_path):
    (tmp_path / "a").write_text("a file")
    for folder in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(MatcapError, match="a file stands"), Output(folder).stage():
            pass
        with pytest.raises(MatcapError, match="a file stands"):
            check_writable(folder, 1)


def test_check_writable_leaves_the_folders_as_they_were(tmp_path):
    (tmp_path / "a").mkdir()
    check_writable(tmp_path / "a" / "b", 1000)
    assert list(tmp_path.rglob("*")) == [tmp_path / "a"]


def test_a_full_disk_is_refused_with_both_sizes(tmp_path):
    with pytest.raises(MatcapError, match=r"1e\+03 PB|1000 PB") as caught:
        check_writable(tmp_path / "a", 10**18)
    assert "left" in str(caught.value) and list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(MatcapError, match="no permission"):
            check_writable(tmp_path / "a", 1)
    finally:
        tmp_path.chmod(0o700)


def test_existing_files_need_overwrite_and_inputs_are_never_replaced(tmp_path):
    (tmp_path / "a").write_text("old")
    check_output([tmp_path / "b"])
    check_output([tmp_path / "a"], overwrite=True)
    with pytest.raises(MatcapError, match="a: this exists already; .* give --overwrite"):
        check_output([tmp_path / "a"])
    for inputs in ([tmp_path / "a"], [tmp_path]):
        with pytest.raises(UsageError, match="the same command reads this file"):
            check_output([tmp_path / "a"], inputs=inputs, overwrite=True)
    with pytest.raises(MatcapError, match="this is a folder"):
        check_output([tmp_path], overwrite=True)

"""Folders that appear whole, records that say what is done, and claims."""

import os
import pickle
import subprocess
import sys

import pytest

from matcap.batch.input_folder import WORKSPACE
from matcap.batch.record import FILE, is_done, write_record
from matcap.batch.workspace import open_run, read_failure


def make(run, name, text, identity="i"):
    """A stage with a file and a record, published."""
    stage = run.stage(name)
    (stage / "preview.png").write_text(text)
    write_record(stage, {"identity": identity})
    return run.publish(stage)


def dead_run(out):
    """The folder of a run whose process is gone, as after kill -9."""
    code = (
        "import os, sys, pathlib, matcap.batch.workspace as w\n"
        "opened = w.open_run(pathlib.Path(sys.argv[1]))\n"
        "run = opened.__enter__()\n"
        "run.claim('a'); print(run.folder, flush=True); os.kill(os.getpid(), 9)\n"
    )
    said = subprocess.run([sys.executable, "-c", code, str(out)], capture_output=True, text=True)
    return out / WORKSPACE / "runs" / os.path.basename(said.stdout.strip())


def test_a_material_is_done_when_its_files_and_identity_are_right(tmp_path):
    with open_run(tmp_path) as run:
        folder = make(run, "a", "picture")
        assert is_done(folder, "i")
        assert not is_done(folder, "another")
    (folder / "preview.png").write_text("pict")
    assert not is_done(folder, "i")
    (folder / "preview.png").unlink()
    assert not is_done(folder, "i")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "matcap batch record"}', "[" * 9999])
def test_a_record_that_cannot_be_read_is_none(tmp_path, text):
    (tmp_path / FILE).write_text(text)
    assert not is_done(tmp_path, "i")


def test_a_second_making_replaces_the_first_whole_and_keeps_what_others_put_there(tmp_path):
    with open_run(tmp_path) as run:
        stage = run.stage("a")
        (stage / "a_extra.png").write_text("of the first only")
        (stage / "preview.png").write_text("first")
        write_record(stage, {"identity": "1"})
        folder = run.publish(stage)
        (folder / "my notes.txt").write_text("keep")
        make(run, "a", "second", "2")
        assert sorted(os.listdir(folder)) == [FILE, "my notes.txt", "preview.png"]
        assert (folder / "preview.png").read_text() == "second"
        assert is_done(folder, "2")
    assert os.listdir(tmp_path / WORKSPACE / "runs") == []


def test_output_of_a_plain_capture_makes_room(tmp_path):
    (tmp_path / "a").mkdir()
    for name in ("a_diffuse.png", "report.json", "a.matcap", "other.txt"):
        (tmp_path / "a" / name).write_text("old")
    with open_run(tmp_path) as run:
        folder = make(run, "a", "new")
    assert sorted(os.listdir(folder)) == [FILE, "other.txt", "preview.png"]


def test_a_file_in_the_place_of_a_folder_is_left_alone(tmp_path):
    (tmp_path / "a").write_text("mine")
    with open_run(tmp_path) as run, pytest.raises(OSError):
        make(run, "a", "new")
    assert (tmp_path / "a").read_text() == "mine"


def test_a_claim_keeps_other_living_runs_away(tmp_path):
    with open_run(tmp_path) as one, open_run(tmp_path) as other:
        assert one.claim("a") and one.claim("a")
        assert not other.claim("a") and other.claim("b")
        other.release("a")  # not its own: stays
        assert not other.claim("a")
        one.release("a")
        assert other.claim("a")
    assert os.listdir(tmp_path / WORKSPACE / "claims") == []


def test_the_claim_of_a_dead_run_counts_for_nothing_and_its_folder_goes(tmp_path):
    dead = dead_run(tmp_path)
    assert dead.is_dir() and (tmp_path / WORKSPACE / "claims" / "a").exists()
    with open_run(tmp_path) as run:
        assert not dead.exists()
        assert run.claim("a")


def test_a_living_run_keeps_its_folder(tmp_path):
    with open_run(tmp_path) as one:
        stage = one.stage("a")
        with open_run(tmp_path):
            assert stage.is_dir()


def test_a_run_goes_to_workers_without_its_claims(tmp_path):
    with open_run(tmp_path) as run:
        assert run.claim("a")
        sent = pickle.loads(pickle.dumps(run))
        assert (sent.out, sent.folder, sent.claims) == (run.out, run.folder, {})


def test_what_a_dead_run_had_moved_away_comes_back(tmp_path):
    """Killed between the two renames, or before it had put back what others left there."""
    dead = dead_run(tmp_path)
    for number, name in enumerate(("gone", "here")):
        old = dead / "old" / str(number) / name
        old.mkdir(parents=True)
        (old / "preview.png").write_text("old")
        (old / "notes.txt").write_text("keep")
    (tmp_path / "here").mkdir()
    (tmp_path / "here/preview.png").write_text("new")
    with open_run(tmp_path):
        pass
    assert sorted(os.listdir(tmp_path / "gone")) == ["notes.txt", "preview.png"]
    assert (tmp_path / "here/notes.txt").read_text() == "keep"
    assert (tmp_path / "here/preview.png").read_text() == "new"


def test_what_made_room_comes_back_when_its_successor_cannot_come(tmp_path, monkeypatch):
    rename = os.rename
    with open_run(tmp_path) as run:
        folder = make(run, "a", "first")
        (folder / "notes.txt").write_text("keep")

        def no_stage(source, target):
            if run.folder / "stage" in source.parents and not os.path.exists(target):
                raise OSError(5, "Input/output error")
            rename(source, target)

        monkeypatch.setattr(os, "rename", no_stage)
        with pytest.raises(OSError, match="Input/output"):
            make(run, "a", "second")
        assert (folder / "preview.png").read_text() == "first"
        assert (folder / "notes.txt").read_text() == "keep"


def test_what_others_put_there_survives_a_failure_to_move_it(tmp_path, monkeypatch):
    rename = os.rename
    with open_run(tmp_path) as run:
        folder = make(run, "a", "first")
        (folder / "notes.txt").write_text("keep")

        def no_notes(source, target):
            if source.name == "notes.txt":
                raise OSError(5, "Input/output error")
            rename(source, target)

        monkeypatch.setattr(os, "rename", no_notes)
        with pytest.raises(OSError, match="Input/output"):
            make(run, "a", "second")
    assert (folder / "preview.png").read_text() == "second"
    assert not (folder / "notes.txt").exists()
    monkeypatch.undo()
    with open_run(tmp_path):
        assert (folder / "notes.txt").read_text() == "keep"


def test_failures_are_remembered_and_forgotten(tmp_path):
    with open_run(tmp_path) as run:
        run.write_failure("a", {"identity": "i", "reason": "black"})
        assert read_failure(tmp_path, "a") == {"identity": "i", "reason": "black"}
        run.forget_failure("a")
        assert read_failure(tmp_path, "a") is None
    (tmp_path / WORKSPACE / "failed" / "b").write_text("{torn")
    assert read_failure(tmp_path, "b") is None

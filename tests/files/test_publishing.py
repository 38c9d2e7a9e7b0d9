"""Whatever fails while files are published: the old ones are there, or the new ones whole."""

import json
import os
import random
from contextlib import suppress

import pytest
from failing_disk import Failing, contents, watched
from publishing import WRITERS, Bench, mapset, plain, trials

from matcap.brdf.folder import read_mapset
from matcap.errors import MatcapError
from matcap.files.publish import HIDDEN, JOURNAL, recover
from matcap.files.staging import check_writable, staged

# Of the failures of each writer, each so-manieth; and states of the disk after each step, besides
# all and nothing unsynced. `python tests/files/publishing.py` tries all of them.
_EVERY = {"plain": 1, "mapset": 16, "synth": 29, "export": 20, "capture": 62, "blend": 38}
_CUTS = {"plain": 8}


@pytest.fixture(params=WRITERS, ids=lambda writer: writer.__name__)
def bench(request, tmp_path):
    return Bench(request.param, tmp_path)


def test_no_failure_and_no_power_cut_leaves_a_half(bench):
    for at, mode in trials(bench, _EVERY.get(bench.writer.__name__, 14)):
        bench.fail(at, mode)
    assert bench.cut(random.Random(1), _CUTS.get(bench.writer.__name__, 0)) > 10


def test_what_is_not_synced_is_found_out(tmp_path, monkeypatch):
    """The disk that stands in forgets, so that the test above can fail."""
    monkeypatch.setattr("matcap.files.publish.sync", lambda path: None)
    with pytest.raises(AssertionError, match="power cut"):
        Bench(plain, tmp_path).cut(random.Random(1), 4)


def test_a_folder_in_a_files_place_is_refused_before_anything_is_touched(tmp_path):
    plain(tmp_path / "out", 1)
    (tmp_path / "out" / "new").mkdir()
    before = contents(tmp_path / "out")
    counted = Failing()
    with pytest.raises(MatcapError, match=r"out/new: a folder stands where a file is needed"):
        plain(tmp_path / "out", 2)
    assert contents(tmp_path / "out") == before
    with (
        watched(tmp_path, counted.seen),
        pytest.raises(MatcapError, match=r"new: a folder stands"),
    ):
        check_writable(tmp_path / "out", 1, ["a", "new"])


def test_a_folder_in_the_place_of_a_file_that_would_go_is_refused(tmp_path):
    (tmp_path / "old").mkdir()
    with pytest.raises(MatcapError, match="old: a folder stands"):
        plain(tmp_path, 2)
    assert sorted(os.listdir(tmp_path)) == ["old"]


def test_links_that_a_file_system_does_not_know_are_done_without(tmp_path, monkeypatch):
    def no_link(*_, **__):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_link)
    bench = Bench(plain, tmp_path)
    for at, mode in trials(bench, 1):
        bench.fail(at, mode)
    assert bench.cut(random.Random(1), 2) > 50


def test_a_journal_that_lost_its_stage_still_puts_the_old_back(tmp_path):
    """Somebody tidied up by hand after the power had gone."""
    bench = Bench(plain, tmp_path)
    for at in range(bench.steps):
        bench.begin_anew()
        with watched(bench.out, Failing(at, lasting=True).seen), suppress(MatcapError):
            plain(bench.out, 2)
        for stage in bench.out.glob(f"{HIDDEN}*"):
            if stage.name != JOURNAL:
                for file in stage.iterdir():
                    file.unlink()
                stage.rmdir()
        recover(bench.out)
        assert contents(bench.out) in (bench.before, bench.after)


@pytest.mark.parametrize(
    "name", ["../precious", "/etc/precious", "..", "", "sub/precious", 7], ids=str
)
@pytest.mark.parametrize("role", ["stage", "fresh", "old"])
def test_a_journal_from_elsewhere_moves_no_file_of_other_folders(tmp_path, role, name):
    """A folder that came by mail may hold anything; it is only read."""
    precious, out = tmp_path / "precious", tmp_path / "out"
    precious.write_text("mine")
    (out / JOURNAL).mkdir(parents=True)
    about = {"stage": "stage", "fresh": ["a.exr"], "old": []}
    about[role] = name if role == "stage" else [name]
    (out / JOURNAL / "list.json").write_text(json.dumps(about))
    recover(out)
    assert precious.read_text() == "mine"
    assert not (out / JOURNAL).exists()


def test_nothing_hidden_is_left_when_nothing_failed(tmp_path):
    for version in (1, 2):
        plain(tmp_path, version)
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


def test_an_interrupted_publishing_is_put_right_by_whoever_reads_or_writes_next(tmp_path):
    bench = Bench(mapset, tmp_path)
    unread = 0
    for at in range(0, bench.steps, 3):
        bench.begin_anew()
        with watched(bench.out, Failing(at, lasting=True).seen), suppress(MatcapError):
            mapset(bench.out, 2)
        unread += (bench.out / JOURNAL).exists()
        read_mapset(bench.out)
        assert not (bench.out / JOURNAL).exists()
        assert contents(bench.out) in (bench.before, bench.after)
    assert unread
    bench.fail(bench.steps // 2, "lasting")
    with staged(bench.out) as stage:
        (stage / "later").write_text("1")
    assert not (bench.out / JOURNAL).exists()


def test_documents_come_last_for_whoever_watches(tmp_path, monkeypatch):
    moved = []
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda *a: (moved.append(a[1].name), replace(*a)))
    plain(tmp_path / "out", 1)
    assert moved[-4:] == ["a", "b", "old", "c.json"]

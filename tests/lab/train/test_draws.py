"""Draws beside photographs: what is measured, and what is written of it."""

from small import entry

from matcap.cli.main import main
from matcap.lab.train import pictures
from matcap.lab.train.pack import Pack, first_of_each
from matcap.lab.train.prior_variety import VarietySettings, middles, run_variety


def test_the_page_tells_what_was_measured(prior, pack, tmp_path, monkeypatch):
    pack = Pack((*pack.entries, *(entry(f"simulated{i}", i, simulated=True) for i in range(4))))
    monkeypatch.setattr(pictures, "SIZE", 64)
    monkeypatch.setattr("matcap.lab.train.corpus.LONG_SIDE", 256)
    monkeypatch.setattr("matcap.lab.train.prior_variety.PAIRS", 2)
    said = []
    settings = VarietySettings(draws=16, simulated=5)
    page = run_variety(prior, pack, settings, tmp_path, "matcap prior variety", said.append)
    assert page == (tmp_path / "prior-variety.md").read_text()
    assert "| all | draws |" in page and "| simulated | training photographs |" in page
    assert page.count(" and m") == 2
    assert (tmp_path / "prior-variety.jpg").stat().st_size > 1000
    assert (tmp_path / "prior-blends.jpg").stat().st_size > 1000
    assert said[-1] == "16 of 16 draws"


def test_pictures_are_brought_to_the_same_radiance(prior, pack):
    from matcap.files.srgb import srgb_decode_tensor

    shown = [pictures.middle(pack.entries[0]), pictures.lit(prior.draw(0))]
    means = [float(srgb_decode_tensor(picture).mean()) for picture in shown]
    assert all(abs(mean - 0.25) < 0.03 for mean in means)


def test_a_photograph_itself_is_no_distance_away(prior, pack, monkeypatch):
    """Ends that are among the photographs leave the middle to be told alone."""
    from matcap.lab.measures.variety import describe_pictures

    monkeypatch.setattr(pictures, "SIZE", 64)
    entries = first_of_each(pack.reporting)[:2]
    ends = [prior.draw(0, near=prior.place(e.photo()), spread=0.0) for e in entries]
    (found,) = middles(prior, entries, describe_pictures([pictures.lit(end) for end in ends]))
    assert found.ends < 1e-6 < found.middle
    assert (found.first, found.second) == (entries[0].material, entries[1].material)


def test_the_command_refuses_a_pack_that_is_none(tmp_path, capsys):
    assert main(["prior", "variety", str(tmp_path / "absent.pack"), "-o", str(tmp_path)]) == 3
    assert "there is no such pack" in capsys.readouterr().err

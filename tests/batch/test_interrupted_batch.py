"""A signal that comes when all is made is told, though nothing is left."""

import cv2
import numpy as np

import matcap.batch.whole
from matcap.cli.main import main


def test_an_interrupt_after_the_last_material_is_said(tmp_path, monkeypatch, capsys):
    shoot = tmp_path / "shoot"
    shoot.mkdir()
    cv2.imwrite(str(shoot / "a.jpg"), np.full((96, 128, 3), 128, np.uint8))

    def done(prepared, policy, shown, scheduler):
        for entry in prepared.entries:
            entry.state = "made"
        raise KeyboardInterrupt

    monkeypatch.setattr(matcap.batch.whole, "work_off", done)
    assert main(["batch", str(shoot), "-o", str(tmp_path / "out")]) == 130
    said = capsys.readouterr().err
    assert "1 made" in said and "matcap: interrupted after the last sample was finished." in said

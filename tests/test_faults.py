"""The script of deliberate faults: each still has its place in the code, and some are tried."""

import ast

import pytest
from fault_list import FAULTS
from faults import ROOT, caught, copied
from mutate import Gone, mutated

SOURCE = """
class Light:
    def falloff(self, distance):
        squared = distance**2
        return self.power / squared  # 1 / r^2
"""


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_has_its_place(fault):
    file, text = mutated(ROOT / "matcap", fault.where, fault.right, fault.wrong)
    if file.suffix == ".py":
        assert ast.dump(ast.parse(text)) != ast.dump(ast.parse(file.read_text()))
    assert text != file.read_text()
    assert all((ROOT / one).exists() for one in fault.command if one.startswith("tests/"))


def test_a_fault_is_caught(tmp_path):
    copied(tmp_path)
    assert caught(next(one for one in FAULTS if "add up" in one.name), tmp_path)


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("light.py", SOURCE),
        ("lights/point.py", SOURCE),
        ("light.py", SOURCE.replace("squared", "far")),
        ("light.py", SOURCE.replace("self.power / squared", "(self.power\n            /squared)")),
    ],
    ids=["as it is", "moved", "renamed", "laid out"],
)
@pytest.mark.parametrize("where", ["flash", "flash.light"])
def test_an_innocent_change_moves_no_fault(tmp_path, file, source, where):
    path = tmp_path / "flash" / file
    path.parent.mkdir(parents=True)
    path.write_text(source)
    found, text = mutated(
        tmp_path, f"{where} Light.falloff", "self.power / squared", "self.power * squared"
    )
    assert found == path
    known: dict[str, type] = {}
    exec(text, known)
    lamp = known["Light"]()
    lamp.power = 2.0
    assert lamp.falloff(3.0) == 18.0


def test_what_has_gone_or_is_there_twice_is_named(tmp_path):
    (tmp_path / "flash").mkdir()
    (tmp_path / "flash/light.py").write_text(SOURCE)
    with pytest.raises(Gone, match=r"Light\.glow has gone from flash"):
        mutated(tmp_path, "flash Light.glow", "1", "2")
    with pytest.raises(Gone, match=r"Light\.falloff in flash/light\.py has '3' 0 times"):
        mutated(tmp_path, "flash Light.falloff", "3", "2")
    with pytest.raises(Gone, match="'distance' [2-9] times"):
        mutated(tmp_path, "flash Light.falloff", "distance", "0.0")


def test_a_statement_goes_and_others_take_its_place(tmp_path):
    (tmp_path / "flash").mkdir()
    (tmp_path / "flash/light.py").write_text(SOURCE)
    dropped, two = (
        mutated(tmp_path, "flash Light.falloff", "squared = __**2", wrong)[1]
        for wrong in ("pass", "squared = __; squared = squared**3")
    )
    assert "pass" in dropped and "squared =" not in dropped
    assert "squared = distance\n" in two and "squared = squared ** 3" in two

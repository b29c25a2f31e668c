"""The worked examples of docs/howto/extend.md run as they are printed."""

import re
from pathlib import Path

import numpy as np
import pytest

import petscjam as pj
from petscjam.cli import main
from petscjam.geometry.network import ContactNetwork
from petscjam.io.kinds import KINDS, Kind

pytestmark = pytest.mark.parallel(nprocs=1)
PAGE = (Path(__file__).parents[1] / "docs" / "howto" / "extend.md").read_text()
SIXTEEN = Path(__file__).parent / "data" / "jambashbulk-N16-P1e-3-0001.txt"


def blocks(section):
    """The blocks of Python in a section of the page."""
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def coordination(tmp_path, monkeypatch):
    """The file of the example as a module, and its line in the list."""
    code, line = blocks("An analysis, with its verb, table and picture")
    (tmp_path / "coordination.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    for name, kind in eval(f"{{{line}}}".replace("petscjam.analysis.", ""), {"Kind": Kind}).items():
        monkeypatch.setitem(KINDS, name, kind)
    return tmp_path / "z.h5"


def test_an_analysis(coordination, capsys):
    made = ["coordination", str(SIXTEEN), "--prestress-both", "-o", str(coordination)]
    assert main([*made, "--most", "4"]) == 0
    results = pj.read_results(coordination)
    network = ContactNetwork.of(pj.import_packing(SIXTEEN)).without_rattlers()
    contacts = [
        sum(k in pair for pair in zip(network.i, network.j, strict=True)) for k in np.flatnonzero(network.backbone)
    ]
    expected = np.array([contacts.count(0), contacts.count(1), contacts.count(2), contacts.count(3)]) / len(contacts)
    assert {r.prestress for r in results.values()} == {True, False}
    for r in results.values():
        assert r.shares == pytest.approx([*expected, 1 - expected.sum()])
        assert r.origin.checksum == pj.import_packing(SIXTEEN).checksum
    assert main([*made, "--most", "4", "--resume"]) == 0
    assert main([*made, "--most", "5", "--resume"]) == 2
    capsys.readouterr()
    assert main(["info", str(coordination)]) == 0
    units, heads, *rows = capsys.readouterr().out.splitlines()
    assert units == "shares of the disks"
    assert heads.split()[-6:] == ["z", "=", "3", "z", "=", "4"]
    assert [row.split()[-2:] for row in rows] == 2 * [[f"{share:.4g}" for share in r.shares[3:]]]


def test_its_picture(coordination, capsys, titles):
    from PIL import Image

    assert main(["coordination", str(SIXTEEN), "-o", str(coordination)]) == 0
    assert main(["plot", str(coordination)]) == 0
    assert "share of the disks" in titles
    assert np.asarray(Image.open(coordination.with_suffix(".png")).convert("L")).std() > 1
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "how many disks have how many contacts" in " ".join(capsys.readouterr().out.split())

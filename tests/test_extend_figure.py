"""The figure of docs/howto/extend.md is made by the command."""

import re
import sys
from pathlib import Path

import pytest

from petscjam import figures
from petscjam.cli import main
from petscjam.io.results import read_results

PAGE = Path(__file__).parents[1] / "docs" / "howto" / "extend.md"


@pytest.fixture
def example(tmp_path, monkeypatch):
    """Return the lines of the module, which lies beside its parameters where the package finds it."""
    section = PAGE.read_text(encoding="utf-8").split("## A figure of a paper\n")[1].split("\n## ")[0]
    module, parameters = (re.search(f"```{kind}\n(.*?)```", section, re.DOTALL)[1] for kind in ("python", "toml"))
    (tmp_path / "slow.py").write_text(module)
    (tmp_path / "slow.toml").write_text(parameters)
    monkeypatch.setattr(figures, "__path__", [*figures.__path__, str(tmp_path)])
    monkeypatch.setitem(figures.FIGURES, "slow", "the time that diverges at jamming")
    yield module.splitlines()
    sys.modules.pop("petscjam.figures.slow", None)


def test_the_example_is_a_figure(example, tmp_path, capsys):
    from PIL import Image

    assert 10 <= len([line for line in example if line.strip()]) <= 30
    assert main(["figure", "slow", "--preset", "small", "-o", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "slow.md").read_text()
    assert page in capsys.readouterr().out
    value, _, error = re.search(r"\| τ\* ~ p\^−λ \| (\S+) (±) (\S+) \| −1 \|", page).groups()
    assert float(value) < 0 < float(error)
    assert len(read_results(tmp_path / "out" / "slow.h5")) == 6
    assert Image.open(tmp_path / "out" / "slow.png").convert("L").getextrema() == (0, 255)

"""Laws, potentials and analyses of other packages, by entry points; and files made with them, without them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import sixteen

import petscjam as pj
from petscjam.cli import main
from petscjam.rows.damping import LAWS, StoredLaw

pytestmark = pytest.mark.parallel(nprocs=1)
PAGE = (Path(__file__).parents[1] / "docs" / "howto" / "extend.md").read_text()
COORDINATION = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0]
LAW = """
from dataclasses import dataclass, field
from typing import ClassVar

from petscjam.rows.damping import DampingLaw


@dataclass(frozen=True)
class Sliding(DampingLaw):
    zeta: float = field(default=1.0, metadata={"help": "sliding friction, in k tau1"})
    name: ClassVar[str] = "sliding"
    normal: ClassVar[float] = 0.5
    at_contact_point: ClassVar[bool] = True

    @property
    def tangential(self):
        return self.zeta

    @property
    def fluid(self):
        return 0.25
"""
POTENTIAL = """
import numpy as np

from petscjam.geometry.potential import Potential

W = 0.1
law = Potential(
    "cosh",
    relative=True,
    source="U = w² [cosh(x/w) − 1]",
    U=lambda x: W**2 * (np.cosh(x / W) - 1),
    dU=lambda x: W * np.sinh(x / W),
    d2U=lambda x: np.cosh(x / W),
)
"""
POINTS = """
[petscjam.damping]
sliding = granular_law:Sliding
broken = granular_law:Nothing
contact = granular_law:Sliding
[petscjam.potentials]
cosh = granular_potential:law
none = granular_law:Sliding
[petscjam.analyses]
coordination = granular_analysis:Coordination
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A package that is installed for child processes only, and files made with it."""
    site, work = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("work")
    (site / "granular_law.py").write_text(LAW)
    (site / "granular_potential.py").write_text(POTENTIAL)
    (site / "granular_analysis.py").write_text(COORDINATION)
    information = site / "granular-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: granular\nVersion: 1.0\nSummary: Grains\n")
    (information / "entry_points.txt").write_text(POINTS)
    sixteen().write(work / "p.h5")
    paths = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])

    def command(*words):
        words = [sys.executable, "-m", "petscjam", *words]
        environment = {**os.environ, "PYTHONPATH": paths}
        return subprocess.run(words, cwd=work, env=environment, capture_output=True, text=True)

    made = command("moduli", "p.h5", "--omega", "0.1,1", "--damping", "sliding", "--zeta", "2", "-o", "g.h5")
    assert made.returncode == 0, made.stderr
    two = command("moduli", "p.h5", "--omega", "0.1,1", "--damping", "sliding", "--zeta", "1,2", "-o", "two.h5")
    assert two.returncode == 0, two.stderr
    return command, work, made


def test_a_law_of_a_package_is_an_option(package):
    command, _, _ = package
    assert "--zeta" in command("moduli", "--help").stdout


def test_what_cannot_be_loaded_is_a_warning(package):
    _, _, made = package
    assert "granular: petscjam.damping broken = granular_law:Nothing cannot be loaded" in made.stderr
    assert "granular: petscjam.damping contact = granular_law:Sliding: this name is taken" in made.stderr


def test_a_result_of_such_a_law_is_read_without_it(package, capsys):
    _, work, _ = package
    g = pj.read_modulus(work / "g.h5")
    assert "sliding" not in LAWS
    assert isinstance(g.damping, StoredLaw)
    assert str(g.damping) == "sliding (zeta=2.0)"
    assert (g.damping.normal, g.damping.tangential, g.damping.body, g.damping.fluid) == (0.5, 2.0, 0.0, 0.25)
    assert g.model(g.omega) == pytest.approx(g.values, rel=1e-12)  # with the viscosity of the fluid
    assert (g.to_dataframe().zeta == 2.0).all()
    assert pj.average([g, g]).count == 2
    assert main(["info", str(work / "g.h5")]) == 0
    assert "sliding (zeta=2.0)" in capsys.readouterr().out
    assert main(["info", str(work / "two.h5")]) == 0
    assert "zeta" in capsys.readouterr().out.splitlines()[2]  # a column


def test_the_stored_law_is_the_same_law(package):
    """Solved again with the coefficients of the file alone."""
    _, work, _ = package
    g = pj.read_modulus(work / "g.h5")
    again = pj.complex_modulus(pj.Packing.read(work / "p.h5"), g.omega, damping=g.damping)
    assert np.abs(again.values / g.values - 1).max() < 1e-9
    assert "friction" in command_attributes(work / "g.h5")


def command_attributes(file):
    import h5py

    with h5py.File(file) as h5:
        (group,) = h5.values()
        return dict(group["damping"].attrs)


def test_a_law_of_petscjam_is_stored_as_before(tmp_path):
    sixteen().write(tmp_path / "p.h5")
    assert main(["moduli", str(tmp_path / "p.h5"), "--omega", "1", "-o", str(tmp_path / "g.h5")]) == 0
    assert command_attributes(tmp_path / "g.h5") == {"law": "contact", "beta": 1.0, "rotations": True}


@pytest.mark.slow
def test_a_run_with_such_a_law_is_read_without_it(package):
    command, work, _ = package
    flow = ["shear", "--damping", "sliding", "--zeta", "2", "--particles", "16", "--phi", "0.8", "--rate", "1e-2"]
    done = command(*flow, "--strain", "0.1", "-o", "run.h5")
    assert done.returncode == 0, done.stderr
    run = pj.md.read(work / "run.h5")
    assert str(run.settings.model.law) == "sliding (zeta=2.0)"
    assert run.settings.model.tangential == 2.0
    assert main(["info", str(work / "run.h5")]) == 0
    more = pj.md.shear(run.settings.model.law, start=run, rate=1e-2, strain=0.05)
    assert more.settings.model.law == run.settings.model.law


@pytest.mark.parametrize("said", ["{", "[]", '{"numbers": {}}', '{"numbers": {}, "normal": -1}'])
def test_a_stored_law_of_wrong_content_is_refused(package, tmp_path, said):
    import h5py

    _, work, _ = package
    (tmp_path / "g.h5").write_bytes((work / "g.h5").read_bytes()[:-40])
    with h5py.File(tmp_path / "g.h5", "a") as h5:
        next(iter(h5.values()))["damping"].attrs["friction"] = said
    with pytest.raises(pj.InputError, match=r"g\.h5: .*friction of a law"):
        pj.read_modulus(tmp_path / "g.h5")


@pytest.mark.slow
def test_a_potential_and_an_analysis_of_a_package(package):
    command, work, _ = package
    made = command("prepare", "--particles", "16", "--pressure", "1e-2", "--potential", "cosh", "-o", "cosh.h5")
    assert made.returncode == 0, made.stderr
    assert "petscjam.potentials none" in made.stderr
    assert "a Potential" in made.stderr
    done = command("coordination", "cosh.h5", "--most", "4", "-o", "z.h5")
    assert done.returncode == 0, done.stderr
    for words in (["info", "z.h5"], ["report", "z.h5", "-o", "z.html"], ["export", "z.h5", "-o", "z.csv"]):
        assert command(*words).returncode == 0
    assert "<strong>analysis of the package granular: Grains</strong>" in (work / "z.html").read_text()
    assert "shares" in (work / "z.csv").read_text()

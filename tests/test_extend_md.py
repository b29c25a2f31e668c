"""The examples of docs/howto/extend.md on the engine, laws, potentials and strain modes are run as they stand."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers import twin_matrices

import petscjam as pj
from petscjam.geometry.potential import POTENTIALS
from petscjam.md.observables import BLOCKS, ROWS
from petscjam.md.simulation import Simulation
from petscjam.reference import linear as reference
from petscjam.reference import md as twin
from petscjam.rows.damping import LAWS
from petscjam.rows.kinematics import STRAINS

pytestmark = pytest.mark.parallel(nprocs=1)
PAGE = Path(__file__).parents[1] / "docs" / "howto" / "extend.md"


@pytest.fixture
def example():
    """Return a function that runs the example of a section and returns its names; the lists are restored."""
    lists = ROWS, BLOCKS, LAWS, POTENTIALS, STRAINS
    before = [dict(entries) for entries in lists]

    def run(title):
        section = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
        (text,) = [part for part in section if part.startswith(f"{title}\n")]
        code = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
        assert len([line for line in code.splitlines() if line.strip()]) <= 30
        names = {"__name__": "example"}
        exec(compile(code, str(PAGE), "exec", dont_inherit=True), names)
        return names

    yield run
    for entries, old in zip(lists, before, strict=True):
        entries.clear()
        entries.update(old)


def test_an_observable(example, capsys):
    run = example("An observable of the engine")["run"]
    kinetic = (run.rows["kinetic_xx"] + run.rows["kinetic_yy"]) / 2 * run.state.length**2
    assert run.rows["temperature"] == pytest.approx(kinetic / 64, rel=1e-12)
    assert (run.rows["fastest"] ** 2 >= run.rows["temperature"]).all()
    assert (run.blocks["speeds"].sum(1) == 64 * run.blocks["samples"]).all()
    assert str(run.mean("temperature")) in capsys.readouterr().out


def test_a_damping_law(example):
    names = example("A damping law")
    sliding, g, run = names["Sliding"], names["g"], names["run"]
    assert str(g.damping) == "sliding (zeta=2.0)"
    assert (g.values.imag > 0).all()
    assert run.settings.model.law == sliding(2.0)
    assert run.missed < 0.01
    assert run.rows["heat"].sum() > 0


def test_a_potential(example, capsys):
    names = example("A potential")
    packing, run = names["packing"], names["run"]
    errors = [float(line) for line in capsys.readouterr().out.splitlines()]
    assert len(errors) == 2
    assert max(errors) < 1e-6
    assert packing.certificate.proved
    assert run.state.potential_name == packing.potential_name == "cosh"
    assert run.missed < 0.01
    K, B, _ = twin_matrices(packing, pj.ContactDamping())
    G = [reference.modulus(K, B, omega, packing.box.area) for omega in (1e-9, 1.0)]
    assert names["g"].values == pytest.approx(G, rel=1e-7)
    model = run.settings.model
    assert sum(Simulation(run.state, model).energy()) == pytest.approx(twin.energy(run.state, model), rel=1e-12)


def test_a_strain_mode(example):
    names = example("A strain mode")
    constants = pj.elastic_constants(names["packing"], prestress=False)
    assert names["g"].values[0].real == pytest.approx(constants[0, 0], rel=1e-6)
    assert not np.isclose(constants[0, 0], constants[1, 1], rtol=1e-6)

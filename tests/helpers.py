"""What several test files use: packings, laws, the matrices of the slow twin, the command."""

import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import petscjam as pj
from petscjam.cli import main
from petscjam.md.runs import ENGINES
from petscjam.reference import linear as reference
from petscjam.rows.kinematics import STRAINS

DATA = Path(__file__).parent / "data"
SIXTEEN = DATA / "jambashbulk-N16-P1e-3-0001.txt"
JAXMD = DATA / "jaxmd-2d-polyuniform-N64-Lp-1.nc"
COMMAND = [sys.executable, "-m", "petscjam"]
EVERY_LAW = [
    pj.ContactDamping(),
    pj.ContactDamping(beta=0.01),
    pj.ContactDamping(beta=0.0),
    pj.ContactDamping(rotations=False),
    pj.StokesDrag(eta_fluid=1.0),
]

any_law = pytest.mark.parametrize("law", EVERY_LAW, ids=str)
any_prestress = pytest.mark.parametrize("prestress", [True, False])
any_strain = pytest.mark.parametrize("strain", STRAINS)


def any_engine(names, cases, few=lambda *case: True):
    """Parametrise over engines and cases; those for a GPU are slow but for a few: its simulator is slow.

    Parameters
    ----------
    names : str
        Of the arguments, separated by commas.
    cases : iterable of tuples
    few : callable
        Of a case.
    """
    found = [
        pytest.param(engine, *case, marks=[pytest.mark.slow] * (engine != "cpu" and not few(*case)))
        for case in cases
        for engine in ENGINES
    ]
    return pytest.mark.parametrize(f"engine, {names}", found)


# ---- packings; the same object for the same arguments, so that models of them can be kept


@cache
def sixteen():
    """Return the 16 disks of the published numbers, by jamBashBulk."""
    return pj.import_packing(SIXTEEN)


@cache
def jax_md(index=0):
    """Return one of ten packings of 64 disks by JAX-MD."""
    return pj.import_packing(JAXMD, index)


@cache
def jammed(pressure=1e-2, n=64, seed=7, **options):
    """Return a packing as ``prepare_packing`` makes it, once."""
    return pj.prepare_packing(n, pressure, seed, **options)


@cache
def with_a_rattler():
    """Return the sixteen disks and, in a hole between them, a small seventeenth that touches none."""
    packing = sixteen()
    grid = np.mgrid[0:1:60j, 0:1:60j].reshape(2, -1).T @ packing.box.cell
    gaps = [(np.hypot(*packing.box.minimum_image(packing.positions - x).T) - packing.radii).min() for x in grid]
    radii = [*packing.radii, 0.9 * max(gaps)]
    return replace(packing, positions=[*packing.positions, grid[np.argmax(gaps)]], radii=radii, provenance={})


def lattice(a, b, columns, rows, basis=((0, 0),)):
    """Disks of diameter 1 on a lattice, neighbours at 0.99; ``a``, ``b`` and ``basis`` in units of that."""
    a, b, basis = (0.99 * np.asarray(x, float) for x in (a, b, basis))
    m, n = np.mgrid[0:columns, 0:rows].reshape(2, -1, 1, 1)
    positions = (m * a + n * b + basis).reshape(-1, 2)
    return pj.Packing(positions, np.full(len(positions), 0.5), pj.Box(np.array([columns * a, rows * b])))


def square_lattice(columns, rows):
    return lattice((1, 0), (0, 1), columns, rows)


@cache
def triangular_lattice(n):
    """n × n disks in a cell of the lattice's own symmetry."""
    return lattice((1, 0), (0.5, 0.75**0.5), n, n)


# ---- the slow twin


def twin_contacts(packing, rattlers=False):
    """Return the contacts that the slow twin finds; ``rattlers`` keeps those of disks with fewer than three."""
    found = reference.contacts(packing.positions, packing.radii, packing.box.cell, packing.potential)
    return found if rattlers else reference.without_rattlers(found, len(packing))


def twin_matrices(packing, law, strain="simple-shear", prestress=True):
    """Return K and B, (3N + 1, 3N + 1), and p of the slow twin: rattlers go for contact damping and stay for drag."""
    found = twin_contacts(packing, rattlers=law.body)
    K = reference.hessian(found, packing.radii, strain, prestress)
    if law.body:
        B = reference.stokes_drag(len(packing), packing.box.area, law.fluid, strain)
    else:
        B = reference.contact_damping(found, packing.radii, law.beta, law.rotations, strain)
    pressure = prestress * sum(c.force * np.hypot(c.rx, c.ry) for c in found) / (2 * packing.box.area)
    return K, B, pressure


# ---- the command


def names(message, value):
    """Tell whether ``value`` stands in ``message``; a number by itself: 3 does not in 0.3, 13 or a path."""
    if not re.fullmatch(r"-?\d+", value):
        return value in message
    return re.search(rf"(?<![\w./-]){re.escape(value)}(\.0)?(?!\w|\.\d|/)", message) is not None


def refused(capfd, *arguments):
    """Run the command, expect exit status 2 and one line on standard error alone; return it."""
    capfd.readouterr()
    assert main([str(a) for a in arguments]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    return err


def contents(folder, pattern="*"):
    """Return the bytes of every file below a folder, by its path in there."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob(pattern) if path.is_file()}

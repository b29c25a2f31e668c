"""Stress after a step of strain: the certified G(t), an affine lattice at any strain, and the verb."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import jammed, triangular_lattice
from mpi4py import MPI

import petscjam as pj
from petscjam.cli import main
from petscjam.io.results import read_results
from petscjam.rows.damping import ContactDamping, StokesDrag

pytestmark = pytest.mark.parallel(nprocs=1)
CENTRES = ContactDamping(beta=0.3, rotations=False)


@pytest.fixture(scope="module")
def packing():
    return jammed(2e-2, 32, 3, shear_stabilised=True)


def largest_error(packing, times, law, **options):
    r = pj.step_strain(packing, [1e-6], times, damping=law, **options)
    return np.abs(r.modulus[0] / r.linear - 1).max()


@pytest.mark.parametrize("law", [CENTRES, StokesDrag(1.0)], ids=str)
def test_small_steps_relax_as_the_certified_modulus(packing, law):
    """The error is that of the mass: it falls with it."""
    times = np.geomspace(2.0, 8.0, 3)
    heavy, light = (largest_error(packing, times, law, inertia=x) for x in (4e-3, 1e-3))
    assert light < 2e-4
    assert heavy > 2.5 * light


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("law", [CENTRES, StokesDrag(1.0)], ids=str)
def test_small_steps_relax_as_the_certified_modulus_over_six_decades(packing, law):
    assert largest_error(packing, np.geomspace(0.1, 1e5, 19), law) < 1e-4


def test_a_lattice_moves_affinely_by_any_step():
    """Nothing relaxes: σ of the bonds at 0°, 60° and 120° after x += γ y, and its change of sign with γ by symmetry."""
    steps, size, area = np.array([1e-6, 1e-3, 5e-3]), 0.99, 0.99**2 * 0.75**0.5
    r = pj.step_strain(triangular_lattice(6), steps, [10.0, 20.0], damping=CENTRES, inertia=1e-3)
    for gamma, modulus in zip(steps, r.modulus, strict=True):
        stress = 0.0
        for angle in np.radians([0, 60, 120]):
            x, y = size * np.cos(angle) + gamma * size * np.sin(angle), size * np.sin(angle)
            length = np.hypot(x, y)
            stress -= max(1 - length, 0) * x * y / length / area
        assert modulus == pytest.approx(stress / gamma, rel=1e-6)
    assert r.contact_events.tolist() == [0, 0, 0]


@pytest.mark.slow
def test_the_stress_soon_after_a_step_is_that_of_the_affine_motion():
    """The strain rate in 1/τe is large, as τe is small for a small mass."""
    r = pj.step_strain(triangular_lattice(4), [1e-3, 1e-1], [2e-5], damping=CENTRES, inertia=1.0)
    later = pj.step_strain(triangular_lattice(4), [1e-3, 1e-1], [10.0], damping=CENTRES, inertia=1e-3)
    assert r.modulus == pytest.approx(later.modulus, rel=1e-5)


def test_a_large_step_takes_little_of_the_earliest_time():
    """The strain is applied in time steps of 0.03 of the mass over kτ1, 1e-4 each: less than a tenth of t in all."""
    r = pj.step_strain(triangular_lattice(4), [0.1], [10.0, 20.0], damping=CENTRES, inertia=1e-2)
    assert (0.03 * r.mass * 1000 <= 0.1 * r.time[0]).all()


def test_doubts_about_a_run_are_notes(packing, monkeypatch):
    monkeypatch.setattr("petscjam.md.result.MISSED", 1e-9)
    notes = pj.step_strain(packing, [1e-3, 1e-2], [5.0], damping=CENTRES, inertia=4e-3).notes
    assert any(note.startswith("step 0.01, t to 5: the energy budget misses") for note in notes)
    assert len(notes) == 2


@pytest.mark.parallel(nprocs=2)
def test_two_ranks_have_the_result_of_one(comm):
    packing = jammed(2e-2, 32, 3, shear_stabilised=True)
    one, two = (
        pj.step_strain(packing, [1e-3], [5.0], damping=CENTRES, inertia=4e-3, comm=c) for c in (MPI.COMM_SELF, comm)
    )
    assert (two.modulus == one.modulus).all()
    assert two.linear == pytest.approx(one.linear, rel=1e-8)


def test_a_turned_packing_has_the_modulus_of_its_edge(packing):
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, s], [-s, c]])
    turned = replace(packing, positions=packing.positions @ turn, box=pj.Box(packing.box.cell @ turn))
    a, b = (pj.step_strain(p, [1e-3], [5.0, 10.0], damping=CENTRES, inertia=4e-3) for p in (packing, turned))
    assert b.linear == pytest.approx(a.linear, rel=1e-6)
    assert b.modulus == pytest.approx(a.modulus, rel=1e-6)


def test_results_do_not_depend_on_the_unit_of_length():
    given = jammed(2e-2, 32, 3, shear_stabilised=True, potential_name="harmonic-relative")
    scaled = pj.Packing(2.4 * given.positions, 2.4 * given.radii, pj.Box(2.4 * given.box.cell), given.potential_name)
    a = pj.step_strain(given, [1e-3], [10.0, 30.0], damping=CENTRES, inertia=4e-4)
    b = pj.step_strain(scaled, [1e-3], np.array([10.0, 30.0]) * 2.4**2, damping=CENTRES, inertia=4e-4)
    assert b.mass == pytest.approx(a.mass * 2.4**2)
    assert b.modulus * 2.4**2 == pytest.approx(a.modulus, rel=1e-6)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--step 0", "0 is not above 0"),
        ("--step nan", "neither A:B:N nor a list"),
        ("--step 20", "must be from 1e-12 to 10, not 20"),
        ("--time 0", "0 is not above 0"),
        ("--inertia 0", "inertia must be from 1e-09 to 1, not 0"),
        ("--no-prestress", "unknown argument --no-prestress"),
    ],
)
def test_bad_input_is_refused_in_one_line(packing, tmp_path, capsys, words, message):
    file = tmp_path / "p.h5"
    packing.write(file)
    assert main(["step-strain", str(file), *words.split(), "-o", str(tmp_path / "s.h5")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "s.h5").exists()


def test_the_verb_writes_what_info_and_plot_show(packing, tmp_path, capsys):
    file, out = tmp_path / "p.h5", tmp_path / "s.h5"
    packing.write(file)
    words = f"step-strain {file} --step 1e-3,1e-1 --time 10,20 --inertia 1e-3 -o {out}"
    assert main(words.split()) == 0
    (r,) = read_results(out).values()
    assert r.contact_events[1] > 0
    assert r.modulus[1, 1] < r.modulus[0, 1]
    assert r.modulus[0, 1] == pytest.approx(r.linear[1], rel=0.02)
    capsys.readouterr()
    assert main(["info", str(out)]) == 0
    assert "G linear" in capsys.readouterr().out
    assert main(["plot", str(out), "-o", str(tmp_path / "s.png")]) == 0

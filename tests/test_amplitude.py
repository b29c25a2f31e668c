"""Oscillations of a packing at finite amplitude: the linear limit, closed forms, units, and the verb."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import jammed, triangular_lattice
from mpi4py import MPI

import petscjam as pj
from petscjam.analysis.oscillation import Oscillations, oscillate
from petscjam.cli import main
from petscjam.io.results import read_results
from petscjam.rows.damping import ContactDamping, StokesDrag

pytestmark = pytest.mark.parallel(nprocs=1)
CENTRES = ContactDamping(beta=0.3, rotations=False)


@pytest.fixture(scope="module")
def packing():
    return jammed(2e-2, 32, 3, shear_stabilised=True)


@pytest.mark.parametrize("law", [CENTRES, StokesDrag(1.0)], ids=str)
def test_small_amplitudes_have_the_linear_modulus_with_inertia(packing, law):
    """A periodic cycle returns all disks, and dissipates πγ0²G″."""
    r = oscillate(packing, [1e-6], [0.3, 1.0, 10.0], mass=0.5, cycles=40, damping=law)
    assert np.abs(r.values / r.linear - 1).max() < 1e-4
    assert r.returns.max() < 1e-3
    assert (r.contact_events == 0).all()
    assert np.pi * r.amplitude[:, None] ** 2 * r.values.imag == pytest.approx(r.heat, rel=2e-3)
    assert np.abs(r.higher).max() < 1e-3 * np.abs(r.values).max()


def test_moduli_of_a_lattice_fall_as_its_bonds_turn(monkeypatch):
    """Bonds at 0° and 60° of a triangular lattice that moves affinely: σ(γ) in closed form, at any amplitude.

    The first harmonic is its Fourier integral; at this compression no contact is lost. At ω = 0 it has no loss.
    """
    monkeypatch.setattr("petscjam.analysis.oscillation.STATES", 32)
    lattice, gamma = triangular_lattice(4), 5e-3
    r = oscillate(lattice, [gamma], [0, 1e-3], cycles=3, damping=ContactDamping(beta=0.0, rotations=False))
    phase = (np.arange(400) + 0.5) / 400 * 2 * np.pi
    strain, size, area = gamma * np.sin(phase), 0.99, 0.99**2 * 0.75**0.5
    stress = np.zeros_like(strain)
    for angle in np.radians([0, 60, 120]):
        x, y = size * np.cos(angle) + strain * size * np.sin(angle), size * np.sin(angle)
        length = np.hypot(x, y)
        stress += -np.maximum(1 - length, 0) * x * y / length / area
    first, third = (2 / gamma * np.mean(stress * np.sin(n * phase)) for n in (1, 3))
    assert r.values[0, 1].real == pytest.approx(first, rel=1e-3)
    assert r.higher[0, 0, 1].real == pytest.approx(third, abs=1e-3 * first)
    assert r.values[0, 0] == pytest.approx(first, rel=1e-9)
    assert r.higher[0, 0, 0] == pytest.approx(third, abs=1e-9 * first)
    assert [r.heat[0, 0], r.contact_events[0, 0], r.returns[0, 0]] == pytest.approx([0, 0, 0], abs=1e-9)


def test_a_packing_that_unjams_quasistatically_keeps_the_other_numbers(packing, monkeypatch, tmp_path):
    """NaN and a note there."""
    monkeypatch.setattr("petscjam.analysis.oscillation.STATES", 8)
    loose = jammed(1e-4, 64, 1, shear_stabilised=True)
    r = oscillate(loose, [1e-7, 1e-3], [0, 1.0], cycles=3, damping=CENTRES)
    assert np.isfinite(r.values[:, 1]).all() and np.isfinite(r.values[0, 0])
    assert np.isnan([r.values[1, 0], r.heat[1, 0], r.returns[1, 0]]).all()
    assert any(note.startswith("amplitude 0.001, omega 0: the packing unjams") for note in r.notes)
    assert np.isnan(r.onset[0])


@pytest.mark.slow
def test_the_engine_tends_to_the_quasistatic_limit(packing):
    """At a large amplitude, without viscosity; at a larger one instabilities dissipate energy, the area of the loop."""
    r = oscillate(packing, [1e-6, 3e-2, 6e-2], [0, 1e-3], cycles=3, damping=CENTRES)
    assert r.values[0, 0] == pytest.approx(r.linear[0], rel=1e-6)
    assert r.values[1, 0].real < 0.6 * r.linear[0].real
    assert r.values[1, 1].real == pytest.approx(r.values[1, 0].real, rel=3e-3)
    assert abs(r.values[1, 0].imag) < 1e-6 * r.values[1, 0].real
    assert 0.05 < r.values[2, 0].imag / r.values[2, 0].real < r.values[2, 1].imag / r.values[2, 1].real
    assert r.heat[2, 0] == pytest.approx(np.pi * 6e-2**2 * r.values[2, 0].imag, rel=2e-3)


def test_large_amplitudes_change_contacts_and_soften(packing):
    r = oscillate(packing, [0.1, 1e-3, 3e-2, 1e-5], [0.1], cycles=5)
    assert r.amplitude.tolist() == [1e-5, 1e-3, 3e-2, 0.1]
    assert r.values[3, 0].real < 0.9 * r.values[0, 0].real
    assert (np.diff(r.contact_events[:, 0]) >= 0).all()
    assert r.contact_events[3, 0] > 0.1
    assert 1e-3 < r.onset[0] < 0.1
    assert r.departure[0, 0] == 0


@pytest.mark.parallel(nprocs=2)
def test_two_ranks_have_the_result_of_one(comm):
    packing = jammed(2e-2, 32, 3, shear_stabilised=True)
    one, two = (oscillate(packing, [1e-3], [1.0], cycles=3, damping=CENTRES, comm=c) for c in (MPI.COMM_SELF, comm))
    assert (two.values == one.values).all()
    assert two.linear == pytest.approx(one.linear, rel=1e-11)
    assert comm.allgather(two.returns.tolist()) == [one.returns.tolist()] * 2


def test_an_amplitude_or_a_frequency_twice_counts_once(packing):
    """The progress goes up to 1."""
    parts = []
    r = oscillate(
        packing, [1e-2, 1e-3, 1e-2], [1.0, 1.0], cycles=3, damping=CENTRES, progress=lambda *new: parts.append(new[0])
    )
    assert r.values.shape == (2, 1)
    assert parts == sorted(parts)
    assert parts[-1] == pytest.approx(1)


def test_a_turned_packing_has_the_moduli_of_its_edge(packing):
    """Engine and linear response shear along the same edge of the cell."""
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, s], [-s, c]])
    turned = replace(packing, positions=packing.positions @ turn, box=pj.Box(packing.box.cell @ turn))
    a, b = (oscillate(p, [1e-3], [1.0], cycles=3, damping=CENTRES) for p in (packing, turned))
    assert b.linear == pytest.approx(a.linear, rel=1e-8)
    assert b.values == pytest.approx(a.values, rel=1e-6)
    assert b.origin.checksum == turned.checksum
    assert any("turned by -28.6479 degrees" in note for note in b.notes)


def test_doubts_about_a_run_are_notes(packing, monkeypatch):
    monkeypatch.setattr("petscjam.md.result.MISSED", 1e-9)
    notes = oscillate(packing, [1e-3, 1e-2], [1.0], cycles=3, damping=CENTRES).notes
    assert any(note.startswith("amplitude 0.01, omega 1: the energy budget misses") for note in notes)
    assert len(notes) == 2


def made(values, amplitude):
    """A result with these moduli."""
    A, W = np.shape(values)
    zeros = np.zeros((A, W))
    packing = triangular_lattice(4)
    origin = pj.viscosity(packing, prestress=False).origin
    values = np.array(values, complex)
    return Oscillations(
        origin,
        np.array(amplitude),
        np.ones(W),
        1.0,
        4,
        values,
        zeros + 0j,
        np.zeros((2, A, W)) + 0j,
        values[0],
        zeros,
        zeros,
        zeros,
    )


def test_the_onset_is_interpolated_in_the_logarithm():
    """Departures 0.01 and 1 at 1e-3 and 1e-1: 0.1 at 1e-2. The last departure counts; NaN if it is not enclosed."""
    r = made([[1.0, 1.0, 1.0, 1.0], [0.99, 1.01, 2.0, 1.2], [0.0, 1.05, 1.0, 1.3]], [1e-5, 1e-3, 1e-1])
    assert r.onset[0] == pytest.approx(1e-2)
    assert np.isnan(r.onset[1:]).all()


def test_results_do_not_depend_on_the_unit_of_length(packing):
    """Of a harmonic packing k has no length; with relative overlaps stresses are in ke/length²."""
    for name, stress in (("harmonic", 1.0), ("harmonic-relative", 2.4**2)):
        given = jammed(2e-2, 32, 3, shear_stabilised=True, potential_name=name)
        scaled = pj.Packing(2.4 * given.positions, 2.4 * given.radii, pj.Box(2.4 * given.box.cell), name)
        a = oscillate(given, [1e-3], [0.3], cycles=4, damping=CENTRES)
        b = oscillate(scaled, [1e-3], [0.3 / stress], cycles=4, damping=CENTRES, mass=stress)
        assert b.values * stress == pytest.approx(a.values, rel=1e-6)
        assert b.returns == pytest.approx(a.returns, rel=1e-4)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--amplitude 0", "0 is not above 0"),
        ("--amplitude nan", "neither A:B:N nor a list"),
        ("--amplitude 20", "must be from 1e-12 to 10, not 20"),
        ("--mass 0", "must be from 1e-50 to 1e+50, not 0"),
        ("--cycles 2", "must be a whole number from 3"),
        ("--omega -1", "must be from 0 to 1e+100, not -1"),
        ("--no-prestress", "unknown argument --no-prestress"),
        ("--engine abacus", "no engine 'abacus'"),
    ],
)
def test_bad_input_is_refused_in_one_line(packing, tmp_path, capsys, words, message):
    file = tmp_path / "p.h5"
    packing.write(file)
    assert main(["oscillate", str(file), *words.split(), "-o", str(tmp_path / "o.h5")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "o.h5").exists()


def test_the_verb_writes_what_info_and_plot_show(packing, tmp_path, capsys):
    file, out = tmp_path / "p.h5", tmp_path / "o.h5"
    packing.write(file)
    words = f"oscillate {file} --amplitude 1e-3,1e-2 --omega 1 --cycles 3 --mass 2 -o {out}"
    assert main(words.split()) == 0
    (r,) = read_results(out).values()
    assert (r.mass, r.cycles) == (2.0, 3)
    again = oscillate(packing, [1e-3, 1e-2], [1.0], cycles=3, mass=2.0)
    assert r.values == pytest.approx(again.values, rel=1e-12)
    capsys.readouterr()
    assert main(["info", str(out)]) == 0
    assert "onset" in capsys.readouterr().out
    assert main(["plot", str(out), "-o", str(tmp_path / "o.png")]) == 0


def test_a_packing_out_of_balance_is_sheared_with_a_word(packing):
    moved = replace(packing, positions=packing.positions + 1e-3 * np.sin(np.arange(64)).reshape(32, 2))
    r = oscillate(moved, [1e-3], [1.0], cycles=3)
    assert any("not in balance" in note for note in r.notes)

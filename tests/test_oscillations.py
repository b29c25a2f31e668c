"""Moduli and harmonics of oscillatory shear: of a known stress, of a lattice, and of the linear response."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers import jammed, triangular_lattice, twin_matrices

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.md import protocols
from petscjam.md.oscillations import harmonics, summary
from petscjam.md.runs import run
from petscjam.plots.shear import plot_run
from petscjam.plots.tables import describe_run
from petscjam.rows.damping import ContactDamping

pytestmark = pytest.mark.parallel(nprocs=1)
CENTRES = ContactDamping(beta=1.0, rotations=False)
TRUE = {1: 0.3 + 0.2j, 2: 0.05 - 0.01j, 3: 0.02 + 0.07j, 5: -0.01 + 0.004j}
AMPLITUDE, OMEGA, CYCLES = 0.01, 0.1, 8
EACH = pytest.mark.parametrize("integrator", ["heun", "single"])


def swing(packing, omega, cycles=6, amplitude=1e-6, law="CD", Q=0.5, **options):
    return run(protocols.oscillation(amplitude, omega, cycles), law, Q=Q, start=packing, **options)


# A known stress


@pytest.fixture(scope="module")
def made():
    """A run to put another stress into; its time does not begin at 0."""
    start = pj.md.shear("CD", 36, 0.8, rate=1e-2, strain=0.1)
    return run(protocols.oscillation(AMPLITUDE, OMEGA, CYCLES), "CD", start=start)


def with_stress(made, noise=0.0, rows=None):
    """The run with the stress of TRUE, averaged over each row, and a mean stress."""
    assert made.settings.time0 > 0
    edges, fine = np.append(made.settings.time0, made.time), (np.arange(1000) + 0.5) / 1000
    rng, stress = np.random.default_rng(1), []
    for a, b in pairwise(edges):
        phase = OMEGA * (a + (b - a) * fine - made.settings.time0)
        sigma = sum(g.real * np.sin(n * phase) + g.imag * np.cos(n * phase) for n, g in TRUE.items())
        stress.append(0.7 + AMPLITUDE * sigma.mean() + noise * rng.normal())
    zero = np.zeros(len(made.time))
    parts = {name: zero for name in made.rows if name.startswith(("dissipative_", "kinetic_"))}
    apart = replace(made.state, radii=0.01 * made.state.radii)  # no contact: no viscosity
    found = replace(made, rows={**made.rows, **parts, "elastic_xy": -np.array(stress)}, state=apart)
    return found if rows is None else replace(found, rows={name: v[rows] for name, v in found.rows.items()})


def test_harmonics_of_a_known_stress(made):
    """Long rows too: each harmonic is averaged over a row. Even ones do not leak into the others."""
    h = harmonics(with_stress(made))
    assert h.orders.tolist() == [1, 3, 5]
    assert h.moduli == pytest.approx([TRUE[n] for n in (1, 3, 5)], abs=1e-6)
    assert np.abs(h.errors).max() < 1e-6
    assert h.cycles == 6
    assert (h.amplitude, h.omega, h.modulus) == (AMPLITUDE, OMEGA, h.moduli[0])
    assert harmonics(with_stress(made), orders=(2,)).moduli == pytest.approx([TRUE[2]], abs=1e-6)
    assert list(h.means) == ["G′", "G″", "G3′", "G3″", "G5′", "G5″"]
    assert h.means["G3″"].value == pytest.approx(0.07, abs=1e-6)


def test_errors_are_those_of_means_over_cycles(made):
    """White noise on K rows: the variance of a coefficient is 2 noise²/K."""
    noise = 0.1 * AMPLITUDE
    h = harmonics(with_stress(made, noise), skip=0)
    expected = 0.1 * (2 / len(made.time)) ** 0.5
    errors = np.concatenate([h.errors.real, h.errors.imag])
    assert np.sqrt((errors**2).mean()) == pytest.approx(expected, rel=0.5)
    away = np.abs(h.moduli - [TRUE[n] for n in h.orders])
    assert away.max() < 5 * expected


def test_cycles_at_the_start_can_be_left_out(made):
    assert harmonics(with_stress(made), skip=7).cycles == 1
    assert np.isnan(harmonics(with_stress(made), skip=7).errors).all()
    with pytest.raises(InputError, match="8 complete cycles, of which 8 are left out"):
        harmonics(with_stress(made), skip=8)
    half = harmonics(with_stress(made, rows=made.time - made.settings.time0 < 63 * CYCLES / 2))
    assert half.cycles == 3
    with pytest.raises(InputError, match="0 complete cycles"):
        harmonics(with_stress(made, rows=made.time - made.settings.time0 < 60))


def test_other_protocols_have_no_harmonics():
    steady = pj.md.shear("CD", 36, 0.8, rate=1e-2, strain=0.1)
    with pytest.raises(InputError, match="of the protocol 'steady'"):
        harmonics(steady)
    assert summary(steady) == steady.means()


def test_rows_are_at_most_a_32nd_of_a_period():
    """Shorter than the 50 steps of other rows, if the period is; --row-time is as asked."""
    fast = run(protocols.oscillation(1e-3, 1.0, 2), "CD", 36, 0.8, dt=0.04)
    assert len(fast.time) == pytest.approx(64, abs=20)
    assert fast.settings.row_steps == 4
    coarse = run(protocols.oscillation(1e-3, 0.1, 2), "CD", 36, 0.8, row_time=2 * np.pi / 0.1 / 7)
    assert harmonics(coarse).orders.tolist() == [1]
    short = run(protocols.oscillation(1e-3, 1.0, 2), "CD", 36, 0.8, dt=0.04, row_time=3.0)
    with pytest.raises(InputError, match="3 rows in a cycle, at least 4 are needed"):
        harmonics(short)
    assert "at least 4 are needed" in describe_run(short)


# The dynamics


@EACH
@pytest.mark.parametrize("mass", [1.0, 4.0])
@pytest.mark.parametrize(("law", "tangential"), [("CD", 1.0), ("CD_n", 0.0)])
def test_the_moduli_of_a_triangular_lattice(law, tangential, mass, integrator):
    """All disks move affinely: G′ = Σ [k (rx ny)² − (f/r)(ry ny)²]/V, G″ = ω Σ [kn (rx ny)² + kt (ry ny)²]/V.

    Errors are of second order in the time step.
    """
    omega, Q, r = 0.3, 0.5, 0.99
    swung = swing(triangular_lattice(6), omega, 4, law=law, Q=Q, mass=mass, integrator=integrator)
    h, second = harmonics(swung), (omega * swung.settings.dt) ** 2
    nx, ny = np.cos(angles := np.radians([0, 60, 120])), np.sin(angles)
    area, f = r**2 * 0.75**0.5, 1 - r
    storage = np.sum((r * nx * ny) ** 2 - f / r * (r * ny * ny) ** 2) / area
    loss = omega / Q * np.sum((r * nx * ny) ** 2 + tangential * (r * ny * ny) ** 2) / area
    assert abs(h.modulus - storage - 1j * loss) < second * abs(h.modulus)
    assert np.abs(h.moduli[1:]).max() < 1e-4 * storage


@pytest.mark.parametrize("name", ["harmonic", "harmonic-relative"])
def test_slow_oscillations_show_the_modulus_of_the_linear_response(name):
    """In the overdamped limit, of a packing in a cell that is not a square; the mean of P and Z stays."""
    start = jammed(2e-2, 64, 3, shear_stabilised=True, potential_name=name)
    ds, omega, Q = 2 * start.radii.min(), 0.01, 0.5
    swung = swing(start, omega)
    h = harmonics(swung)
    packing = pj.Packing(start.positions / ds, start.radii / ds, pj.Box(start.box.cell / ds), name)
    g = pj.complex_modulus(packing, [omega / Q], damping=CENTRES).values[0]
    assert swung.state.height != swung.state.length
    assert h.modulus.real == pytest.approx(g.real, rel=1e-3)
    assert h.modulus.imag == pytest.approx(g.imag, rel=3e-3)
    assert np.abs(h.moduli[1:]).max() < 1e-3 * abs(g)
    assert summary(swung)["P"].value == pytest.approx(swung.pressure[0], rel=1e-4)


@EACH
@pytest.mark.parametrize(("omega", "mass"), [(0.2, 1.0), (0.2, 4.0), (1.0, 1.0)])
def test_fast_oscillations_show_the_modulus_with_inertia(omega, mass, integrator):
    """Sγγ − Sγu (Suu − Mω²)⁻¹ Suγ with S = K + iωB, by the matrices of the slow twin."""
    packing, Q = jammed(2e-2, 64, 3, shear_stabilised=True), 0.5
    K, B, _ = twin_matrices(packing, CENTRES)
    S = K + 1j * omega * B / Q
    inner = S[:-1, :-1] - mass * omega**2 * np.eye(len(S) - 1)
    g = (S[-1, -1] - S[-1, :-1] @ np.linalg.solve(inner, S[:-1, -1])) / packing.box.area
    h = harmonics(swing(packing, omega, 8, mass=mass, integrator=integrator))
    assert h.modulus.real == pytest.approx(g.real, rel=5e-3)
    assert h.modulus.imag == pytest.approx(g.imag, rel=2e-3)


def test_large_amplitudes_have_a_third_harmonic():
    """Softer, more lossy, and the fit of a cycle follows the stress."""
    packing = jammed(2e-2, 64, 3, shear_stabilised=True)
    small, large = (harmonics(swing(packing, 0.1, 6, amplitude)) for amplitude in (1e-5, 0.1))
    assert large.modulus.real < 0.9 * small.modulus.real
    assert abs(large.moduli[1]) > 30 * abs(small.moduli[1])
    assert abs(large.moduli[1]) > 5 * abs(large.errors[1])


def test_info_and_figure_of_an_oscillation(tmp_path, capsys):
    """Moduli and harmonics instead of the steady means."""
    file = tmp_path / "run.h5"
    words = "shear --model CD --particles 36 --phi 0.9 --oscillate 0.01:0.1:5 -o"
    assert main([*words.split(), str(file)]) == 0
    assert main(["info", str(file)]) == 0
    text = capsys.readouterr().out
    for name in ("G′ ", "G″ ", "G3′", "G5″", "P ", "Z "):
        assert f"\n{name}" in text
    for name in ("Σ", "μ", "ησ", "Bp", "Rv"):
        assert f"\n{name}" not in text
    assert f"G″           {harmonics(pj.md.read(file)).modulus.imag:.4g} ±" in text
    plot_run(pj.md.read(file), tmp_path / "run.png")
    assert main(["info", str(tmp_path)]) == 0
    head, row = capsys.readouterr().out.splitlines()[1:3]
    assert head.split() == ["run", "strain", "G′", "G″", "P", "Z"]
    assert f"{harmonics(pj.md.read(file)).modulus.imag:.4g} ±" in row

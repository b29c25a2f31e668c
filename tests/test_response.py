"""Facts that any G* obeys: the slow twin, closed forms, identities, limits."""

import itertools
from dataclasses import replace

import helpers
import numpy as np
import pytest
from helpers import jax_md, sixteen, square_lattice, triangular_lattice, twin_contacts, twin_matrices, with_a_rattler

import petscjam as pj
from petscjam.reference import linear as reference
from petscjam.rows.damping import LAWS
from petscjam.rows.kinematics import STRAINS

OMEGA = np.geomspace(1e-4, 1e3, 8)
EVERY_LAW = [*helpers.EVERY_LAW, pj.StokesDrag(eta_fluid=0.0)]


def touching_rattler(overlap=1e-9):
    """The same, grown until it overlaps one disk by a part of its own radius, or more by more."""
    packing = with_a_rattler()
    r = packing.radii.copy()
    r[-1] *= 1.0 / 0.9 * (1 + overlap)
    return replace(packing, radii=r)


def twin(packing, law, omega, strain, prestress):
    """G* by the slow twin; rattlers go for contact damping and stay for drag."""
    K, B, p = twin_matrices(packing, law, strain, prestress)
    G = np.array([reference.modulus(K, B, w, packing.box.area) for w in omega])
    if strain == "compression":
        G = (G + 2 * p) / 4
    return G


PACKINGS = {"jamBashBulk": sixteen, "jax-md": jax_md, "rattler": with_a_rattler, "touching rattler": touching_rattler}


@pytest.mark.parametrize("prestress", [True, False])
@pytest.mark.parametrize("strain", STRAINS)
@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
@pytest.mark.parametrize("packing", PACKINGS)
def test_slow_twin(packing, law, strain, prestress):
    packing, omega = PACKINGS[packing](), OMEGA[1:-1:2]
    fast = pj.complex_modulus(packing, omega, damping=law, strain=strain, prestress=prestress)
    slow = twin(packing, law, omega, strain, prestress)
    assert fast.values.real == pytest.approx(slow.real, rel=1e-8)
    assert fast.values.imag == pytest.approx(slow.imag, rel=1e-8)


def test_every_law_is_tested():
    assert {type(law) for law in EVERY_LAW} == set(LAWS.values())


@pytest.mark.parametrize("index", range(3))
def test_stokes_drag_is_its_modal_sum(index):
    packing = jax_md(index)
    found = twin_contacts(packing, rattlers=True)
    K = reference.hessian(found, packing.radii)
    by_hand = [reference.stokes_modal_sum(K, w, packing.box.area, 0.7) for w in OMEGA]
    g = pj.complex_modulus(packing, OMEGA, damping=pj.StokesDrag(0.7))
    assert g.values == pytest.approx(np.array(by_hand), rel=1e-10)


@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
def test_limit_of_low_frequency(law):
    """G′ → G0 and G″/ω → η0, with corrections of order ω²: a tenth of ω, a hundredth of the error."""
    g = pj.complex_modulus(jax_md(), [1e-3, 1e-4], damping=law)
    storage, loss = np.abs(g.values.real - g.G0), np.abs(g.values.imag / g.omega - g.eta0)
    assert storage[1] <= 0.0101 * storage[0] + 1e-13
    assert loss[1] <= 0.0101 * loss[0] + 1e-12
    assert storage[0] < 1e-3 * g.G0
    assert loss[0] < 1e-2 * g.eta0


@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
def test_limit_of_high_frequency(law):
    """G′ → G∞ and G″/ω → η∞, with corrections of order 1/ω²."""
    g = pj.complex_modulus(jax_md(), [1e3, 1e4], damping=law)
    storage, loss = np.abs(g.values.real - g.G_inf), np.abs(g.values.imag / g.omega - g.eta_inf)
    assert storage[1] <= 0.0101 * storage[0] + 1e-13
    assert loss[1] <= 0.0101 * loss[0] + 1e-12
    assert storage[0] < 1e-2 * g.G_inf


@pytest.mark.parametrize("overlap", [-0.1, 1e-9, 0.03, 0.06])
def test_low_frequency_viscosity_with_a_dragged_rattler(overlap):
    """η0 is the limit of the sweep also where a rattler follows its neighbours (none, one, two)."""
    packing = touching_rattler(overlap)
    assert pj.ContactNetwork.of(packing).rattlers == 1
    g = pj.complex_modulus(packing, [1e-5], damping=pj.StokesDrag(1.0), prestress=False)
    assert g.eta0 == pytest.approx(g.values[0].imag / 1e-5, rel=1e-8)
    assert g.G0 == pytest.approx(g.values[0].real, rel=1e-8)


@pytest.mark.parametrize("law", [pj.StokesDrag(0.0), pj.ContactDamping()], ids=str)
def test_a_rattler_that_rests_on_another_is_not_in_contact(law):
    """Whether it overlaps by 1e-14 or stays clear by as much is rounding, and changes nothing."""
    clear, resting = (pj.complex_modulus(touching_rattler(x), OMEGA, damping=law) for x in (-1e-3, 1e-14))
    assert resting.values == pytest.approx(clear.values, rel=1e-12)
    assert resting.eta0 == pytest.approx(clear.eta0, rel=1e-12)


@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("law", [pj.StokesDrag(0.0), pj.ContactDamping()], ids=str)
def test_any_image_of_a_prepared_packing(law, seed):
    """Rattlers and all: whole lattice vectors change nothing but rounding."""
    packing = pj.prepare_packing(64, 1e-3, seed)
    assert packing.certificate.rattlers > 0
    shifts = np.random.default_rng(seed).integers(-3, 4, (64, 2))
    moved = replace(packing, positions=packing.positions + shifts @ packing.box.cell)
    before, after = (pj.complex_modulus(p, OMEGA, damping=law) for p in (packing, moved))
    assert after.values == pytest.approx(before.values, rel=1e-8)
    assert after.eta0 == pytest.approx(before.eta0, rel=1e-8)


def test_one_disk_and_its_images():
    """Nothing can move but the cell: G* = (K_γγ + iωB_γγ)/V of three contacts, at 0°, 60° and 120°.

    Simple shear stretches each of the two slanted ones by a sin 60° cos 60°.
    """
    a = 0.99
    packing = pj.Packing([[0.3, 0.2]], [0.5], pj.Box([[a, 0], [a / 2, a * 0.75**0.5]]))
    g = pj.complex_modulus(packing, [1.0], damping=pj.StokesDrag(2.0), prestress=False)
    G = 2 * a**2 * (0.75 * 0.25) / packing.box.area
    assert g.values[0] == pytest.approx(G + 2j, rel=1e-12)
    assert [g.G0, g.G_inf, g.eta0, g.eta_inf] == pytest.approx([G, G, 2.0, 2.0], rel=1e-12)


@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
@pytest.mark.parametrize("strain", STRAINS)
def test_power_balance_closes(law, strain):
    g = pj.complex_modulus(jax_md(), OMEGA, damping=law, strain=strain)
    assert g.power_balance.max() < 1e-12


@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
def test_residuals_are_at_rounding(law):
    assert pj.complex_modulus(jax_md(), OMEGA, damping=law).residuals.max() < 1e-12


@pytest.mark.parametrize("seed", range(4))
def test_any_packing_without_tangential_damping_and_prestress_is_kelvin_voigt(seed):
    """BT eq. 18, for the BT potential, in a cell tilted at random."""
    packing = pj.prepare_packing(24, 10.0 ** -(1 + seed % 3), seed)
    a, b = packing.box.cell
    tilted = replace(packing, box=pj.Box([a + (seed - 2) * b, b + seed * a + seed * (seed - 2) * b]))
    g = pj.complex_modulus(tilted, OMEGA, damping=pj.ContactDamping(beta=0.0), prestress=False)
    assert g.values == pytest.approx(g.G0 * (1 + 1j * OMEGA), rel=1e-11)
    assert [g.eta0, g.G_inf, g.eta_inf] == pytest.approx([g.G0] * 3, rel=1e-11)


def test_one_symbolic_analysis_a_sweep():
    """PETSc's own log: three patterns (sweep, K on the backbone, θ alone), W + 3 factorisations."""
    from petscjam.parallel.petsc import petsc

    log = petsc().Log
    log.begin()
    events = [log.Event(name) for name in ("MatCholFctrSym", "MatCholFctrNum")]
    stage = log.Stage("petscjam: factor").id
    before = [event.getPerfInfo(stage)["count"] for event in events]
    pj.complex_modulus(jax_md(), OMEGA)
    after = [event.getPerfInfo(stage)["count"] for event in events]
    assert [b - a for a, b in zip(before, after, strict=True)] == [3, len(OMEGA) + 3]


@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
def test_storage_modulus_never_falls_with_frequency(law):
    """K_uu is positive definite here, so each mode only stiffens."""
    g = pj.complex_modulus(jax_md(), np.geomspace(1e-4, 1e4, 60), damping=law)
    assert g.negative_modes == 0
    assert np.diff(g.values.real).min() > -1e-12


@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
@pytest.mark.parametrize("omega", [0.03, 1.0])
def test_kramers_kronig(law, omega):
    """H = G* − G∞ − iωη∞ is causal: H′(ω) = −(2/π) ⨍ xH″(x)/(x² − ω²) dx.

    The grid is even in log x and meets ω half-way between two points, where the principal value of
    the subtracted pole vanishes by symmetry.
    """
    step = 0.05
    x = omega * np.exp(step * (np.arange(-360, 360) + 0.5))
    g = pj.complex_modulus(sixteen(), [omega, *x], damping=law)
    H = g.values - g.G_inf - 1j * g.omega * g.eta_inf
    integrand = (x * H[1:].imag - omega * H[0].imag) / (x**2 - omega**2) * x
    assert H[0].real == pytest.approx(-2 / np.pi * step * integrand.sum(), abs=1e-6 * g.G_inf)


@pytest.mark.parametrize("turns", list(itertools.product([-2, 1], [0, 3])), ids=str)
@pytest.mark.parametrize("law", [pj.ContactDamping(), pj.StokesDrag()], ids=str)
def test_a_tilt_by_whole_lattice_vectors_is_the_same_system(law, turns):
    packing = sixteen()
    a, b = packing.box.cell
    a2 = a + turns[0] * b
    tilted = replace(packing, box=pj.Box([a2, b + turns[1] * a2]))
    before, after = (pj.complex_modulus(p, OMEGA, damping=law) for p in (packing, tilted))
    assert after.values == pytest.approx(before.values, rel=1e-10)


def test_any_periodic_image_of_a_disk_will_do():
    packing = sixteen()
    shifts = np.random.default_rng(1).integers(-3, 4, (16, 2))
    moved = replace(packing, positions=packing.positions + shifts @ packing.box.cell)
    before, after = (pj.complex_modulus(p, OMEGA).values for p in (packing, moved))
    assert after == pytest.approx(before, rel=1e-10)


@pytest.mark.parametrize("size", [(2, 2), (4, 4), (3, 4), (3, 3)], ids=str)
def test_square_lattice_with_and_without_gears(size):
    """Counter-rotation costs nothing on an even lattice; sliding then cannot be rolled away by it.

    Under simple shear every vertical contact slides by γ·a, and rolling (θ the same for all) takes
    half of it to the horizontal contacts: η∞ = ½·β·a²/V per disk, whatever the parity.
    """
    g = pj.complex_modulus(square_lattice(*size), [1.0], prestress=False)
    assert g.eta_inf == pytest.approx(0.5, rel=1e-10)


def test_two_disks_that_meet_through_two_images():
    """A cell two disks wide: each touches the other on both sides."""
    g = pj.complex_modulus(square_lattice(2, 2), [1.0], prestress=False, strain="compression")
    # K_γγ = 2 contacts a disk, each stretched by ε a: B = ¼ · 2 a²/a² = ½
    assert g.values[0] == pytest.approx(0.5 * (1 + 1j), rel=1e-12)


def test_conjugate_at_negative_frequency():
    """A(−ω) = A(ω)*, so the solution is conjugate: checked on the assembled pencil."""
    from petscjam.parallel.comm import resolve
    from petscjam.parallel.solver import direct_solver
    from petscjam.response.matrices import assembled
    from petscjam.response.problem import LinearProblem
    from petscjam.rows.kinematics import SIMPLE_SHEAR

    comm = resolve()
    problem = LinearProblem(jax_md(), pj.ContactDamping(), [SIMPLE_SHEAR], True, comm)
    dofs = problem.number(problem.active)
    with assembled(problem.K, problem.B, dofs, comm) as pencil, direct_solver(comm, "test_", definite=False) as solver:
        solutions = []
        for omega in (0.3, -0.3):
            solver.factor(pencil.combine(1, 1j * omega))
            solutions.append(solver.solve((pencil.k + 1j * omega * pencil.b)[:, 0])[0])
    assert solutions[1] == pytest.approx(solutions[0].conj(), rel=1e-12)


@pytest.mark.parallel(nprocs=[1, 2, 3])
@pytest.mark.parametrize("law", EVERY_LAW, ids=str)
def test_the_answer_does_not_depend_on_the_number_of_ranks(comm, law):
    from mpi4py import MPI

    together = pj.complex_modulus(jax_md(), OMEGA, damping=law, comm=comm, fields_at=OMEGA[:2])
    alone = pj.complex_modulus(jax_md(), OMEGA, damping=law, comm=MPI.COMM_SELF, fields_at=OMEGA[:2])
    assert together.values == pytest.approx(alone.values, rel=1e-10)
    assert [together.G0, together.eta0, together.G_inf, together.eta_inf] == pytest.approx(
        [alone.G0, alone.eta0, alone.G_inf, alone.eta_inf], rel=1e-10
    )
    assert together.fields == pytest.approx(alone.fields, rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("law", EVERY_LAW[:1] + EVERY_LAW[-1:], ids=str)
def test_displacements_of_rattlers(law):
    """Taken out, they have none; dragged along without contacts, they move with the fluid."""
    g = pj.complex_modulus(with_a_rattler(), [0.1], damping=law, fields_at=[0.1])
    assert np.isnan(g.fields[0, 16]).all() if law.body == 0 else (g.fields[0, 16] == 0).all()
    assert np.isfinite(g.fields[0, :16]).all()


@pytest.mark.parallel(nprocs=3)
def test_a_split_communicator(comm):
    """Two teams, each with a packing of its own."""
    team = comm.Split(comm.rank // 2, comm.rank)
    g = pj.complex_modulus(jax_md(comm.rank // 2), [0.1], comm=team)
    expected = pj.complex_modulus(jax_md(comm.rank // 2), [0.1], comm=comm.Split(comm.rank))
    assert g.values == pytest.approx(expected.values, rel=1e-12)


@pytest.mark.parallel(nprocs=3)
def test_a_rank_that_owns_nothing(comm):
    """Two disks with their own images, three ranks."""
    cell = 0.99 * np.array([[1.0, 0.0], [1.0, 2.0]])
    two = pj.Packing([[0, 0], [0, 0.99]], [0.5, 0.5], pj.Box(cell))
    assert pj.complex_modulus(two, [1.0], comm=comm, prestress=False).values == pytest.approx(
        twin(two, pj.ContactDamping(), [1.0], "simple-shear", False), rel=1e-10
    )


@pytest.mark.parallel(nprocs=2)
def test_different_packings_on_different_ranks_are_refused(comm):
    with pytest.raises(pj.InputError, match="differ between the ranks"):
        pj.complex_modulus(jax_md(comm.rank), [1.0], comm=comm)


def test_an_unstable_packing_is_flagged():
    """A square lattice under pressure, without next neighbours, shears downhill."""
    g = pj.complex_modulus(square_lattice(4, 4), [1.0])
    assert g.G0 < 0
    assert not g.stable


@pytest.mark.parametrize("law", [pj.ContactDamping(), pj.StokesDrag()], ids=str)
def test_a_floppy_network_is_not_called_stable(law):
    """A square lattice of springs shears for nothing, row by row: no G0, no η0, and a note that says why."""
    g = pj.complex_modulus(square_lattice(4, 4), [1e-3, 1.0], damping=law, prestress=False)
    assert np.isnan([g.G0, g.eta0]).all()
    assert "floppy modes" in " ".join(g.notes)
    assert not g.stable
    assert g.negative_modes == 0


@pytest.mark.parallel(nprocs=2)
def test_different_frequencies_on_different_ranks_are_refused(comm):
    with pytest.raises(pj.InputError, match="differ between the ranks"):
        pj.complex_modulus(sixteen(), [1.0, -1.0][comm.rank], comm=comm)


def test_the_user_can_bring_pivoting_back(workspace):
    """The option holds at every factorisation of a sweep, not only at the first."""
    from petscjam.parallel import solver

    workspace("mat_mumps_cntl_1", 0.25)
    seen = []

    class Watched(solver.DirectSolver):
        def factor(self, A):
            super().factor(A)
            seen.append(self._factor().getMumpsCntl(1))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solver, "DirectSolver", Watched)
        pj.complex_modulus(triangular_lattice(6), [0.1, 1.0, 10.0], prestress=False)
    assert seen[:4] == [0.25] * 4


@pytest.mark.parametrize("omega", [[0.0], [-1.0], [np.nan], [np.inf], []])
def test_bad_frequencies_are_refused(omega):
    with pytest.raises(pj.InputError, match="omega"):
        pj.complex_modulus(sixteen(), omega)


@pytest.mark.parametrize(
    "make", [lambda: pj.ContactDamping(-0.1), lambda: pj.ContactDamping(np.nan), lambda: pj.StokesDrag(-1)]
)
def test_bad_laws_are_refused(make):
    with pytest.raises(pj.InputError, match=r"must be from 0 to 1e\+09"):
        make()


def test_workspace_that_is_too_small_is_enlarged(workspace):
    """MUMPS asked for less than half of what it needs (INFOG(1) = −9): the retry succeeds."""
    workspace("mat_mumps_icntl_14", -60)
    g = pj.complex_modulus(triangular_lattice(12), [0.1, 1.0], prestress=False)
    assert g.residuals.max() < 1e-12


def test_a_failure_of_mumps_is_explained(workspace):
    """No more than a megabyte (ICNTL(23)) will not do for this many disks."""
    workspace("mat_mumps_icntl_23", 1)
    with pytest.raises(pj.SolverError, match=r"INFOG\(1\) = -\d+"):
        pj.complex_modulus(triangular_lattice(40), [0.1])


@pytest.fixture
def workspace():
    """Set a PETSc option of the solver, for one test."""
    from petscjam.parallel.petsc import petsc

    options, names = petsc().Options("petscjam_"), {"mat_mumps_icntl_14"}

    def set_option(name, value):
        names.add(name)
        options.setValue(name, value)

    yield set_option
    for name in names:
        options.delValue(name)


def test_unknown_strain_is_refused():
    with pytest.raises(pj.InputError, match="torsion"):
        pj.complex_modulus(sixteen(), [1.0], strain="torsion")


def test_a_packing_without_contacts_is_refused():
    packing = sixteen()
    with pytest.raises(pj.InputError, match="no contacts"):
        pj.complex_modulus(replace(packing, radii=packing.radii / 2), [1.0])

"""Facts that the low modes and the slow relaxations obey: dense algebra, the slow twin, published numbers."""

from functools import cache

import numpy as np
import pytest
from helpers import (
    EVERY_LAW,
    any_law,
    any_prestress,
    any_strain,
    jammed,
    lattice,
    sixteen,
    square_lattice,
    triangular_lattice,
    twin_contacts,
    twin_matrices,
)
from mpi4py import MPI
from scipy.linalg import eigh
from scipy.sparse import csc_array

import petscjam as pj
from petscjam.parallel.eigen import Pairs, lowest_pairs, pencil_pairs
from petscjam.parallel.matrix import symmetric_matrix
from petscjam.parallel.petsc import destroying, petsc
from petscjam.preparation import certify as certify_module
from petscjam.preparation.certify import below_all, certify, hessian, lowest_eigenpairs, pivots_below
from petscjam.reference import linear as reference
from petscjam.response import modes as modes_module
from petscjam.response import relaxations as relaxations_module
from petscjam.response.modes import lowest_modes
from petscjam.response.problem import LinearProblem
from petscjam.response.relaxations import relaxation_modes
from petscjam.rows.kinematics import SIMPLE_SHEAR

PUBLISHED = {
    True: ([0.0595119881, 0.1284532830, 0.1912115675], 0.1088011),
    False: ([0.0612012380, 0.1307559102, 0.1938721026], 0.1105622390),
}


@cache
def random_disks(n=48, phi=2.0, seed=3):
    """No minimum: most of its low modes are negative."""
    rng = np.random.default_rng(seed)
    radii = np.where(np.arange(n) % 2, 0.7, 0.5)
    side = np.sqrt(np.pi * (radii**2).sum() / phi)
    return pj.Packing(rng.uniform(0, side, (n, 2)), radii, pj.Box.square(side))


@cache
def triangular(columns=8, rows=4):
    """A triangular crystal in a rectangular cell, two disks a row of it: degenerate by reflections."""
    return lattice((1, 0), (0, 3**0.5), columns, rows, [(0, 0), (0.5, 0.75**0.5)])


@cache
def rhombic(n=8):
    """A triangular crystal in a cell of its own symmetry: sets of 6 and 12 equal modes."""
    return triangular_lattice(n)


def honeycomb(n):
    """Three contacts a disk: without pre-stress half of the modes are at zero."""
    return lattice((3**0.5, 0), (0.75**0.5, 1.5), n, n, [(0, 0), (0, 1)])


@cache
def copies(n=3):
    """n × n copies of a packing: a wave and the one that runs backwards are degenerate."""
    one = jammed(3e-2, 12, 1)
    shifts = np.mgrid[0:n, 0:n].reshape(2, -1).T @ one.box.cell
    positions = (one.positions + shifts[:, None]).reshape(-1, 2)
    return pj.Packing(positions, np.tile(one.radii, n * n), pj.Box(n * one.box.cell))


DEGENERATE = [triangular, rhombic, copies]
any_degenerate = pytest.mark.parametrize("make", DEGENERATE)


def in_units(packing, length, potential):
    return pj.Packing(length * packing.positions, length * packing.radii, pj.Box(length * packing.box.cell), potential)


@cache
def all_modes(packing, prestress=True, strain="simple-shear"):
    return lowest_modes(packing, 10**6, prestress=prestress, strain=strain)


def dense(packing, prestress=True, strain="simple-shear"):
    """K_uu and K_uγ on the backbone, K_γγ, by loops."""
    K = reference.hessian(twin_contacts(packing), packing.radii, strain, prestress)
    u = np.flatnonzero(np.repeat(pj.ContactNetwork.of(packing).backbone, 2))
    return K[np.ix_(u, u)], K[u, -1], K[-1, -1]


def without_translations(K):
    """Eigenvalues and vectors of K, the two translations moved above all others and left out."""
    e = np.tile(np.eye(2), len(K) // 2) / np.sqrt(len(K) / 2)
    values, vectors = np.linalg.eigh(K + 2 * np.abs(K).sum(1).max() * e.T @ e)
    return values[:-2], vectors[:, :-2]


# ---- eigenvalues


@any_prestress
def test_modes_of_the_published_packing(prestress):
    m = lowest_modes(sixteen(), 3, prestress=prestress)
    assert m.eigenvalues == pytest.approx(PUBLISHED[prestress][0], abs=1e-10)


@any_prestress
@pytest.mark.parametrize("make", [sixteen, jammed, random_disks])
def test_all_modes_are_those_of_the_dense_matrix(make, prestress):
    values, _ = without_translations(dense(make(), prestress)[0])
    assert all_modes(make(), prestress).eigenvalues == pytest.approx(values, abs=1e-12 * values[-1])


@pytest.mark.parametrize("make", [jammed, random_disks])
@pytest.mark.parametrize("count", [1, 5, 30])
def test_the_lowest_modes_come_first_and_none_is_missed(make, count):
    values, _ = without_translations(dense(make())[0])
    m = lowest_modes(make(), count)
    assert m.eigenvalues == pytest.approx(values[:count], abs=1e-9)
    assert m.complete is True


def test_a_packing_that_is_no_minimum_has_negative_modes():
    assert lowest_modes(random_disks(), 5).frequencies[0] < -0.1


def test_vectors_are_those_of_the_dense_matrix():
    _, vectors = without_translations(dense(jammed(1e-3))[0])
    overlap = lowest_modes(jammed(1e-3), 10).vectors.reshape(10, -1) @ vectors[:, :10]
    assert np.abs(overlap) == pytest.approx(np.eye(10), abs=1e-7)


@pytest.mark.parametrize("packing", [square_lattice(6, 6), square_lattice(4, 9)], ids=["6×6", "4×9"])
@any_prestress
def test_degenerate_modes_stay_orthonormal(packing, prestress):
    v = lowest_modes(packing, 20, prestress=prestress).vectors.reshape(20, -1)
    assert v @ v.T == pytest.approx(np.eye(20), abs=1e-12)


def test_modes_are_orthogonal_to_translations():
    assert lowest_modes(jammed(1e-3), 20).vectors.sum(1) == pytest.approx(0, abs=1e-10)


def test_residuals_are_those_of_the_dense_matrix():
    m, (K, _, _) = lowest_modes(jammed(1e-3), 20), dense(jammed(1e-3))
    v = m.vectors.reshape(20, -1).T
    true = np.linalg.norm(K @ v - v * m.eigenvalues, axis=0)
    assert m.residuals == pytest.approx(true, abs=1e-13)
    assert (true < 1e-8 * m.eigenvalues).all()


def test_floppy_modes_take_no_part_in_the_response():
    m = all_modes(square_lattice(4, 4), False, "compression")
    assert any("modes at zero" in note for note in m.notes)
    assert np.isfinite(m.amplitudes).all() and np.isfinite(m.softening).all()


# ---- degenerate modes


@pytest.fixture
def slepc_alone(monkeypatch):
    monkeypatch.setattr(modes_module, "LARGEST_DENSE", 0)


def same_vectors(some, all_of_them):
    return some.vectors == pytest.approx(all_of_them.vectors[: len(some.vectors)], abs=1e-7)


@any_degenerate
def test_lists_do_not_depend_on_the_count(make, slepc_alone):
    """Each is the start of the dense matrix's, every copy of an eigenvalue among them."""
    values, _ = without_translations(dense(make())[0])
    longest = lowest_modes(make(), 41)
    assert np.isclose(values[:40], values[1:41], rtol=1e-9).sum() > 12
    for count in range(1, 41, 3 if make is copies else 1):
        m = lowest_modes(make(), count)
        assert m.eigenvalues == pytest.approx(values[:count], rel=1e-10), count
        assert m.complete is True and m.notes == ()
        assert (m.residuals < 1e-8 * m.eigenvalues).all()
        v = m.vectors.reshape(count, -1)
        assert v @ v.T == pytest.approx(np.eye(count), abs=1e-12)
        assert same_vectors(m, longest), count


@any_degenerate
def test_both_eigensolvers_choose_the_same_vectors(make, monkeypatch):
    lapack = lowest_modes(make(), 30)
    monkeypatch.setattr(modes_module, "LARGEST_DENSE", 0)
    slepc = lowest_modes(make(), 30)
    assert searched(slepc) and not searched(lapack)
    assert same_vectors(slepc, lapack)
    assert slepc.participation == pytest.approx(lapack.participation, rel=1e-7)


@pytest.mark.parametrize("count", [1, 7, 20, 40])
def test_degenerate_modes_of_no_minimum_are_found_from_below(count, slepc_alone):
    packing = square_lattice(12, 12)
    values, _ = without_translations(hessian(pj.ContactNetwork.of(packing)).toarray())
    m = lowest_modes(packing, count)
    assert values[0] < -0.01
    assert m.eigenvalues == pytest.approx(values[:count], abs=1e-10) and m.complete


def test_more_equal_modes_than_are_searched_for(slepc_alone):
    """Which of the modes at zero come is arbitrary; that they are the lowest is proved, and they are said."""
    packing = honeycomb(12)
    K = hessian(pj.ContactNetwork.of(packing), False).toarray()
    zero = int((np.abs(np.linalg.eigvalsh(K)) < 1e-10).sum()) - 2
    m = lowest_modes(packing, 10, prestress=False)
    assert zero > 100 and m.eigenvalues == pytest.approx(np.zeros(10), abs=1e-12)
    assert m.complete is True
    assert any(f"the last 10 are of {zero} equal ones" in note for note in m.notes)


@pytest.mark.parallel(nprocs=[1, 2, 3])
@any_degenerate
@pytest.mark.parametrize("count", [5, 20])
def test_degenerate_modes_do_not_depend_on_the_number_of_ranks(comm, make, count, slepc_alone):
    alone = lowest_modes(make(), count, comm=MPI.COMM_SELF)
    m = lowest_modes(make(), count, comm=comm)
    assert m.eigenvalues == pytest.approx(alone.eigenvalues, rel=1e-10) and m.complete
    assert same_vectors(m, alone)


@pytest.mark.parametrize("length", [1e-9, 1e9])
@pytest.mark.parametrize("potential", ["harmonic", "harmonic-relative"])
@pytest.mark.parametrize("make", [jammed, random_disks, *DEGENERATE])
def test_modes_do_not_depend_on_the_unit_of_length(make, potential, length, slepc_alone):
    """K scales with the stiffness of a contact, 1 or 1/σ²; vectors and proofs stay what they are."""
    unit = 1.0 if potential == "harmonic" else length**-2
    one = lowest_modes(in_units(make(), 1.0, potential), 9)
    m = lowest_modes(in_units(make(), length, potential), 9)
    assert m.eigenvalues == pytest.approx(unit * one.eigenvalues, rel=1e-11, abs=0)
    assert same_vectors(m, one)
    assert (m.complete, m.notes) == (True, one.notes)


@pytest.mark.parametrize("make", [*DEGENERATE, random_disks])
def test_a_certificate_lists_every_copy(make):
    values, _ = without_translations(dense(make())[0])
    assert certify(make()).certificate.eigenvalues == pytest.approx(values[:4], rel=1e-10)


# ---- the count


class Forgetful:
    """The eigensolver, less the fourth mode in each of the first searches."""

    def __init__(self, lapses):
        self.lapses = lapses

    def __call__(self, K, count, *arguments, **options):
        if self.lapses == 0:
            return lowest_pairs(K, count, *arguments, **options)
        self.lapses -= 1
        found = lowest_pairs(K, count + 1, *arguments, **options)
        return Pairs(*(np.delete(part, 3, axis=-1) for part in found))


def test_a_missed_mode_is_searched_for(monkeypatch):
    monkeypatch.setattr(modes_module, "lowest_pairs", Forgetful(1))
    values, _ = without_translations(dense(jammed(1e-3))[0])
    m = lowest_modes(jammed(1e-3), 10)
    assert m.eigenvalues == pytest.approx(values[:10], abs=1e-9)
    assert m.complete and m.performance["eigensolves"] == 2


def test_a_mode_that_is_missed_again_and_again_is_an_error(monkeypatch):
    monkeypatch.setattr(modes_module, "lowest_pairs", Forgetful(-1))
    with pytest.raises(pj.SolverError, match="missed 1 of the lowest modes"):
        lowest_modes(jammed(1e-3), 10)


def failing(*_):
    raise pj.SolverError("no memory")


def test_modes_that_cannot_be_counted_are_not_called_complete(monkeypatch):
    monkeypatch.setattr(modes_module, "pivots_below", failing)
    m = lowest_modes(jammed(1e-3), 10)
    assert m.complete is None
    assert "the modes could not be counted: no memory" in m.notes


def test_relaxations_that_cannot_be_counted_are_not_called_complete(monkeypatch):
    monkeypatch.setattr(relaxations_module, "negative_pivots", failing)
    r = relaxation_modes(jammed(1e-3), 10)
    assert r.complete is None
    assert "the modes could not be counted: no memory" in r.notes


@pytest.mark.parametrize("make", [random_disks, lambda: square_lattice(6, 6)], ids=["random", "square"])
def test_a_shift_below_all_modes_is_found_though_counts_fail(make, monkeypatch):
    K = hessian(pj.ContactNetwork.of(make()))
    lowest = np.linalg.eigvalsh(K.toarray())[0]
    assert 6 * lowest < below_all(K) < lowest
    monkeypatch.setattr(certify_module, "pivots_below", failing)
    assert below_all(K) < lowest


def test_a_count_that_rounding_may_change_is_none():
    K = csc_array(np.diag([1.0, 2.0, 3.0]))
    assert pivots_below(K, 2.5, 0.5) == 2
    with pytest.raises(pj.SolverError, match="has rounding errors up to"):
        pivots_below(K, 2.5, 1e-18)


# ---- LAPACK for many modes, SLEPc for few


def searched(m):
    """Whether SLEPc looked for them: LAPACK needs no count."""
    return m.performance["count_seconds"] > 0


@pytest.mark.parallel(nprocs=[1, 2, 3])
@any_prestress
@pytest.mark.parametrize("make", [jammed, random_disks])
@pytest.mark.parametrize("count", [30, 10**6])
def test_both_eigensolvers_agree(comm, make, count, prestress, monkeypatch):
    lapack = lowest_modes(make(), count, prestress=prestress, comm=comm)
    monkeypatch.setattr(modes_module, "LARGEST_DENSE", 0)
    slepc = lowest_modes(make(), count, prestress=prestress, comm=comm)
    assert searched(slepc) and not searched(lapack)
    assert lapack.eigenvalues == pytest.approx(slepc.eigenvalues, abs=1e-11)
    assert max(lapack.residuals.max(), slepc.residuals.max()) < 1e-9 * abs(slepc.eigenvalues).max()
    assert lapack.complete is slepc.complete is True
    # a cluster may turn, so what is compared is the space
    v, w = (m.vectors.reshape(len(m.vectors), -1) for m in (lapack, slepc))
    assert np.linalg.norm(v @ w.T, axis=1) == pytest.approx(1, abs=1e-9)


@any_prestress
def test_few_modes_of_a_larger_packing_are_searched_for(prestress):
    packing = jammed(n=256)
    m = lowest_modes(packing, 8, prestress=prestress)
    values, _ = without_translations(hessian(pj.ContactNetwork.of(packing), prestress).toarray())
    assert searched(m) and m.complete
    assert m.eigenvalues == pytest.approx(values[:8], rel=1e-8)
    assert (m.residuals < 1e-8 * m.eigenvalues).all()


# ---- the response


@any_prestress
def test_all_modes_soften_the_published_packing_to_its_modulus(prestress):
    m = all_modes(sixteen(), prestress)
    assert m.G_affine - m.softening.sum() == pytest.approx(PUBLISHED[prestress][1], abs=5e-8)


@any_strain
@any_prestress
def test_all_modes_soften_to_the_modulus(strain, prestress):
    m = all_modes(jammed(1e-3), prestress, strain)
    g = pj.complex_modulus(jammed(1e-3), [1.0], prestress=prestress, strain=strain)
    assert m.G_affine - m.softening.sum() == pytest.approx(g.G0, rel=1e-9)


@any_strain
def test_the_response_of_all_modes_is_that_of_a_dense_solve(strain):
    K, k, _ = dense(jammed(1e-3), True, strain)
    u = -(np.linalg.pinv(K, rcond=1e-12) @ k).reshape(-1, 2)
    m = all_modes(jammed(1e-3), True, strain)
    assert m.response(len(m.eigenvalues)).nonaffine == pytest.approx(u, abs=1e-9 * abs(u).max())


@any_strain
def test_contacts_of_the_response_are_those_of_the_slow_twin(strain):
    packing = jammed(1e-3)
    m = all_modes(packing, True, strain)
    parts = m.response(7)
    q = np.zeros(3 * len(packing) + 1)
    q[:-1].reshape(-1)[: 2 * len(packing)].reshape(-1, 2)[m.disks] = parts.nonaffine
    q[-1] = 1.0
    twin = [np.array(reference.rows(c, packing.radii, strain, arms=0)) @ q for c in twin_contacts(packing)]
    fast = np.stack([parts.parallel, parts.transverse], axis=1)
    order, slow = np.lexsort(fast.T.round(9)), np.array(twin)
    assert fast[order] == pytest.approx(slow[np.lexsort(slow.T.round(9))], abs=1e-10)


def test_no_modes_leave_the_affine_motion():
    parts = all_modes(jammed(1e-3)).response(0)
    network = pj.ContactNetwork.of(jammed(1e-3)).without_rattlers()
    assert (parts.nonaffine == 0).all()
    assert parts.parallel == pytest.approx(network.normal[:, 0] * network.r[:, 1], abs=1e-14)


def test_modes_of_a_minimum_soften():
    assert (all_modes(jammed(1e-3)).softening >= 0).all()


def test_floppiness_is_that_of_the_slow_twin():
    m, packing = lowest_modes(jammed(1e-3), 4), jammed(1e-3)
    q = np.zeros((4, len(packing), 2))
    q[:, m.disks] = m.vectors
    motions = np.hstack([q.reshape(4, -1), np.zeros((4, len(packing) + 1))])
    rows = np.array([reference.rows(c, packing.radii, "simple-shear", arms=0) for c in twin_contacts(packing)])
    relative = ((rows @ motions.T) ** 2).sum(0)
    assert m.floppiness == pytest.approx(np.sqrt(relative[1] / relative[0]), rel=1e-10)


def test_participation_is_the_inverse_of_the_fourth_moment():
    """Vectors have length 1: one disk alone would give 1/n, all alike 1."""
    m = lowest_modes(jammed(1e-3), 6)
    fourth = [np.mean([np.hypot(x, y) ** 4 for x, y in v]) * len(v) ** 2 for v in m.vectors]
    assert m.participation == pytest.approx(1 / np.array(fourth), rel=1e-10)


# ---- ranks, options, input


@pytest.mark.parallel(nprocs=[1, 2, 3])
@any_prestress
def test_modes_do_not_depend_on_the_number_of_ranks(comm, prestress):
    alone = lowest_modes(jammed(1e-3), 12, prestress=prestress, comm=MPI.COMM_SELF)
    m = lowest_modes(jammed(1e-3), 12, prestress=prestress, comm=comm)
    for name in ("eigenvalues", "participation", "floppiness", "softening"):
        assert getattr(m, name) == pytest.approx(getattr(alone, name), rel=1e-7), name
    assert m.vectors == pytest.approx(alone.vectors, abs=1e-7)
    assert m.complete


@pytest.mark.parallel(nprocs=[1, 2, 3])
def test_every_rank_has_the_same_modes(comm):
    m = lowest_modes(sixteen(), 8, comm=comm)
    for part in (m.eigenvalues, m.vectors, m.softening, m.residuals):
        assert len(set(comm.allgather(part.tobytes()))) == 1


@pytest.mark.parallel(nprocs=[1, 2, 3])
@any_law
def test_relaxations_do_not_depend_on_the_number_of_ranks(comm, law):
    alone = relaxation_modes(sixteen(), 6, damping=law, comm=MPI.COMM_SELF)
    r = relaxation_modes(sixteen(), 6, damping=law, comm=comm)
    assert r.times == pytest.approx(alone.times, rel=1e-9)
    assert r.weights == pytest.approx(alone.weights, rel=1e-6, abs=1e-12)
    assert r.vectors == pytest.approx(alone.vectors, abs=1e-6)


@pytest.mark.parallel(nprocs=[2])
def test_a_missed_mode_ends_all_ranks(comm, monkeypatch):
    monkeypatch.setattr(modes_module, "lowest_pairs", Forgetful(-1))
    with pytest.raises(pj.SolverError, match="missed"):
        lowest_modes(jammed(1e-3), 10, comm=comm)


@pytest.fixture
def one_iteration():
    options, names = petsc().Options(), ("petscjam_modes_eps_max_it", "petscjam_modes_eps_ncv")
    for name, value in zip(names, (1, 14), strict=True):
        options[name] = value
    yield
    for name in names:
        options.delValue(name)


def test_other_settings_behind_the_prefix(one_iteration):
    with pytest.raises(pj.SolverError, match=r"SLEPc found none of \d+ modes"):
        lowest_modes(jammed(1e-3), 10)


@pytest.mark.parametrize("count", [0, -1, 2.5, True, "many"])
@pytest.mark.parametrize("find", [lowest_modes, relaxation_modes])
def test_a_count_that_is_no_positive_whole_number_is_refused(find, count):
    with pytest.raises(pj.InputError, match="count"):
        find(sixteen(), count)


@pytest.mark.parametrize("find", [lowest_modes, relaxation_modes])
def test_a_disk_that_touches_only_itself_is_refused(find):
    cell = np.array([[0.99, 0.0], [0.495, 0.86]])
    with pytest.raises(pj.InputError, match="one disk"):
        find(pj.Packing(np.zeros((1, 2)), np.array([0.5]), pj.Box(cell)))


@pytest.mark.parametrize("m", [-1, 5])
def test_a_response_of_more_modes_than_there_are_is_refused(m):
    with pytest.raises(pj.InputError, match="m:"):
        lowest_modes(sixteen(), 4).response(m)


# ---- the eigensolver by itself


def petsc_matrix(M):
    rows = csc_array(M).tocsr()
    rows.sort_indices()
    return symmetric_matrix(rows.indptr, rows.indices, rows.data, rows.shape[0], MPI.COMM_SELF)


def test_a_cluster_that_is_cut_gives_real_orthonormal_vectors():
    """Three of a fourfold eigenvalue."""
    M = np.diag(np.repeat([1.0, 2.0, 3.0], 4))
    K = petsc_matrix(M)
    with destroying(K):
        found = lowest_pairs(K, 3, -0.1)
    assert found.values == pytest.approx([1, 1, 1], abs=1e-12)
    assert found.vectors.T @ found.vectors == pytest.approx(np.eye(3), abs=1e-13)


def test_lowest_pairs_are_those_of_a_dense_pencil():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((30, 20))
    M, metric = -X @ X.T, np.diag(rng.uniform(1, 2, 30)) + 0.01
    A, K = petsc_matrix(M), petsc_matrix(metric)
    with destroying(A, K):
        found = pencil_pairs(A, K, 8, prefix="petscjam_test_")
    assert found.values == pytest.approx(eigh(M, metric, eigvals_only=True)[:8], rel=1e-10)
    assert found.vectors.T @ metric @ found.vectors == pytest.approx(np.eye(8), abs=1e-12)


def test_certificates_use_the_same_eigensolver():
    K = hessian(pj.ContactNetwork.of(sixteen()))
    values, vectors, _, complete = lowest_eigenpairs(K, 5)
    assert complete is True
    assert values == pytest.approx(lowest_modes(sixteen(), 5).eigenvalues, rel=1e-10)
    assert (K @ vectors.T) == pytest.approx(vectors.T * values, abs=1e-9)


# ---- relaxations


def eliminated(packing, law, strain="simple-shear"):
    """K, B, K_uγ and B_uγ on the backbone less its first disk, θ following, by loops and dense algebra."""
    n = len(packing)
    K, B, _ = twin_matrices(packing, law, strain)
    turn = np.arange(2 * n, 3 * n)
    B = B - B[:, turn] @ np.linalg.pinv(B[np.ix_(turn, turn)], rcond=1e-12) @ B[turn]
    backbone = pj.ContactNetwork.of(packing).backbone
    u = np.flatnonzero(np.repeat(backbone, 2))
    if not law.body:
        u = u[2:]
    return K[np.ix_(u, u)], B[np.ix_(u, u)], K[u, -1], B[u, -1]


@any_law
@pytest.mark.parametrize("make", [sixteen, jammed])
def test_relaxations_are_those_of_the_dense_pencil(make, law):
    K, B, k, b = eliminated(make(), law)
    if law.body:
        values, v = without_translations(K)
        times, v = 1 / values, v / np.sqrt(values)
    else:
        times, v = (part[..., ::-1] for part in eigh(B, K))
    r = relaxation_modes(make(), 12, damping=law)
    assert r.times == pytest.approx(times[:12], rel=1e-8) and r.complete
    weights = (v.T @ k - v.T @ b / times)[:12] ** 2 / make().box.area
    assert r.weights == pytest.approx(weights, rel=1e-5, abs=1e-9 * weights.max())


@any_law
@pytest.mark.parametrize("make", [rhombic, copies])
def test_lists_of_relaxations_do_not_depend_on_the_count(make, law):
    K, B, _, _ = eliminated(make(), law)
    times = 1 / without_translations(K)[0] if law.body else eigh(B, K, eigvals_only=True)[::-1]
    longest = relaxation_modes(make(), 41, damping=law)
    for count in (1, 2, 8, 13, 27, 40):
        r = relaxation_modes(make(), count, damping=law)
        assert r.times == pytest.approx(times[:count], rel=1e-10), count
        assert r.complete is True and r.notes == ()
        assert same_vectors(r, longest), count


@pytest.mark.parametrize("law", [law for law in EVERY_LAW if not law.body], ids=str)
@pytest.mark.parametrize("make", [sixteen, copies])
def test_slower_relaxations_are_counted(make, law):
    K, B, _, _ = eliminated(make(), law)
    times = eigh(B, K, eigvals_only=True)
    problem = LinearProblem(make(), law, [SIMPLE_SHEAR], True, MPI.COMM_SELF)
    for k in range(1, len(times), 9):
        tau, gap = (times[k - 1] + times[k]) / 2, times[k] - times[k - 1]
        if gap > 1e-6 * tau:
            assert relaxations_module._slower(problem, tau, 0.4 * gap) == len(times) - k
    assert relaxations_module._slower(problem, -1.0, 0.1) == len(times)
    with pytest.raises(pj.SolverError, match="rounding error of the factorisation"):
        relaxations_module._slower(problem, times[-1] / 2, 1e-17 * times[-1])


def test_equal_relaxations_without_end():
    """Without pre-stress and tangential damping B = K: all times are 1."""
    r = relaxation_modes(rhombic(10), 10, prestress=False, damping=pj.ContactDamping(beta=0.0))
    assert r.times == pytest.approx(np.ones(10), rel=1e-12)
    assert r.complete is True
    assert any("the last 10 are of 198 equal ones" in note for note in r.notes)


@pytest.mark.parallel(nprocs=[2, 3])
@any_law
def test_degenerate_relaxations_do_not_depend_on_the_number_of_ranks(comm, law):
    alone = relaxation_modes(copies(), 9, damping=law, comm=MPI.COMM_SELF)
    r = relaxation_modes(copies(), 9, damping=law, comm=comm)
    assert r.times == pytest.approx(alone.times, rel=1e-10) and r.complete
    assert same_vectors(r, alone)


@pytest.mark.parametrize("length", [1e-9, 1e9])
@pytest.mark.parametrize("potential", ["harmonic", "harmonic-relative"])
@any_law
def test_relaxations_do_not_depend_on_the_unit_of_length(law, potential, length):
    stiffness = 1.0 if potential == "harmonic" else length**-2
    one = relaxation_modes(in_units(jammed(1e-3), 1.0, potential), 9, damping=law)
    r = relaxation_modes(in_units(jammed(1e-3), length, potential), 9, damping=law)
    assert r.times * stiffness == pytest.approx(one.times, rel=1e-11)
    assert r.weights / stiffness == pytest.approx(one.weights, rel=1e-8)
    assert r.vectors * stiffness**0.5 == pytest.approx(one.vectors, abs=1e-8 * abs(one.vectors).max())
    assert r.complete is True


@any_law
@any_strain
def test_all_relaxations_together_are_the_modulus(law, strain):
    packing, omega = sixteen(), np.geomspace(1e-3, 1e2, 6)
    r = relaxation_modes(packing, 10**6, damping=law, strain=strain)
    g = pj.complex_modulus(packing, omega, damping=law, strain=strain)
    s = 1j * omega[:, None] * r.times
    G = g.G0 + 1j * omega * g.eta_inf + (r.weights * s / (1 + s)).sum(1)
    assert G == pytest.approx(g.values, rel=1e-7)


@any_law
def test_the_slowest_poles_of_the_spectrum_are_relaxations(law):
    r = relaxation_modes(jammed(1e-3), 40, damping=law)
    poles = pj.spectrum(jammed(1e-3), damping=law, rtol=1e-8).relaxation()
    heavy = poles.weights > 1e-6 * poles.weights.sum()
    slowest = np.argmax(np.where(heavy, poles.times, 0))
    nearest = np.argmin(np.abs(r.times - poles.times[slowest]))
    assert r.times[nearest] == pytest.approx(poles.times[slowest], rel=1e-5)
    assert r.weights[nearest] == pytest.approx(poles.weights[slowest], rel=1e-3)


def test_under_stokes_drag_relaxations_are_modes():
    r, m = relaxation_modes(jammed(1e-3), 9, damping=pj.StokesDrag(2.0)), lowest_modes(jammed(1e-3), 9)
    assert r.times == pytest.approx(1 / m.eigenvalues, rel=1e-9)
    assert r.weights == pytest.approx(m.softening, rel=1e-9)


@any_law
def test_relaxations_are_normalised_by_the_stiffness(law):
    r = relaxation_modes(jammed(1e-3), 9, damping=law)
    v = r.vectors.reshape(9, -1)
    assert v @ dense(jammed(1e-3))[0] @ v.T == pytest.approx(np.eye(9), abs=1e-8)


@any_law
def test_motions_that_do_not_relax_are_refused(law):
    with pytest.raises(pj.SolverError, match="negative modes"):
        relaxation_modes(random_disks(), 5, damping=law)


# ---- the figure


@pytest.mark.parametrize("packings", [[jammed], [random_disks], [sixteen, jammed, random_disks]])
def test_a_figure_is_drawn(tmp_path, packings):
    from petscjam.plots import plot_results

    plot_results({make.__name__: lowest_modes(make(), 5) for make in packings}, tmp_path / "modes.png")
    assert (tmp_path / "modes.png").read_bytes().startswith(b"\x89PNG")

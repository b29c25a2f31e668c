"""K and B as assembled, against the slow twin and against forces they must be derivatives of."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import jax_md

import petscjam as pj
from petscjam.reference import linear as reference
from petscjam.response.matrices import assembled
from petscjam.response.problem import LinearProblem
from petscjam.rows.kinematics import SIMPLE_SHEAR, STRAINS, strain_mode

LAWS = [pj.ContactDamping(0.3), pj.ContactDamping(0.3, rotations=False), pj.StokesDrag(2.0)]


def dense(packing, law, comm, strain=SIMPLE_SHEAR, prestress=True):
    """K and B over all degrees of freedom, ordered as in the slow twin, from the distributed matrices."""
    problem = LinearProblem(packing, law, [strain], prestress, comm)
    n = len(packing)
    dofs = problem.number(np.ones((n, 3), dtype=bool))
    at = np.concatenate([dofs.index[:, :2].ravel(), dofs.index[:, 2]])  # all u, then all θ
    out = []
    with assembled(problem.K, problem.B, dofs, comm) as pencil:
        for matrix, column, corner in (
            (pencil.K, pencil.k, problem.affine[0]),
            (pencil.B, pencil.b, problem.affine[1]),
        ):
            indptr, indices, values = matrix.getValuesCSR()
            local = np.zeros((len(indptr) - 1, dofs.size), dtype=complex)
            np.add.at(local, (np.repeat(np.arange(len(local)), np.diff(indptr)), indices), values)
            whole = np.vstack(comm.allgather(local))
            edge = np.concatenate(comm.allgather(column[:, 0]))
            full = np.zeros((3 * n + 1, 3 * n + 1))
            full[:-1, :-1] = whole[np.ix_(at, at)].real
            full[-1, :-1] = full[:-1, -1] = edge[at]
            full[-1, -1] = corner.real
            out.append(full)
    return out


@pytest.mark.parallel(nprocs=[1, 2, 3])
@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("strain", STRAINS)
def test_matrices_are_those_of_the_slow_twin(comm, law, strain):
    packing = jax_md(4)
    K, B = dense(packing, law, comm, strain_mode(strain))
    found = reference.contacts(packing.positions, packing.radii, packing.box.cell, packing.potential)
    slow = reference.hessian(found, packing.radii, strain)
    if law.body:
        friction = reference.stokes_drag(len(packing), packing.box.area, law.fluid, strain)
    else:
        friction = reference.contact_damping(found, packing.radii, law.beta, law.rotations, strain)
    assert np.abs(K - slow).max() < 1e-13 * np.abs(slow).max()
    assert np.abs(B - friction).max() < 1e-13 * np.abs(friction).max()


@pytest.mark.parallel(nprocs=[1, 2])
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_matrices_are_symmetric(comm, law):
    for matrix in dense(jax_md(4), law, comm):
        assert np.abs(matrix - matrix.T).max() < 1e-14 * np.abs(matrix).max()


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_translations_cost_no_energy_and_dissipate_only_against_a_fluid(comm, law):
    K, B = dense(jax_md(4), law, comm)
    translation = np.zeros(len(K))
    translation[0:128:2] = 1.0
    assert np.abs(K @ translation).max() < 1e-14
    assert translation @ B @ translation == pytest.approx(64 * law.body, abs=1e-13)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_dissipation_is_never_negative(comm, law):
    assert np.linalg.eigvalsh(dense(jax_md(4), law, comm)[1]).min() > -1e-13


def forces(packing, u, s, mode):
    """Net elastic force on every disk, deformed by s and displaced by u."""
    F = np.eye(2) + s * mode.gradient + 0.5 * s**2 * mode.curvature
    moved = replace(packing, positions=packing.positions @ F.T + u, box=packing.box.deformed(F))
    return pj.ContactNetwork.of(moved).residual_force


@pytest.mark.parametrize("strain", STRAINS)
def test_stiffness_is_the_derivative_of_the_force_to_second_order(comm, strain):
    """Central differences: ten times the step, a hundred times the error."""
    packing, mode = jax_md(4), strain_mode(strain)
    K, _ = dense(packing, pj.ContactDamping(), comm, mode)
    u, s = np.random.default_rng(0).normal(size=(64, 2)), 0.7
    exact = -K[:128] @ np.concatenate([u.ravel(), np.zeros(64), [s]])
    balance = forces(packing, 0 * u, 0.0, mode)
    errors = []
    for h in (1e-4, 1e-5):
        difference = (forces(packing, h * u, h * s, mode) - forces(packing, -h * u, -h * s, mode)) / (2 * h)
        errors.append(np.abs(difference.ravel() - exact).max())
    assert np.abs(balance).max() < 1e-9
    assert errors[0] == pytest.approx(100 * errors[1], rel=0.1)
    assert errors[1] < 1e-6


def energy(packing, s, mode):
    """Elastic energy of the affinely deformed packing."""
    F = np.eye(2) + s * mode.gradient + 0.5 * s**2 * mode.curvature
    moved = replace(packing, positions=packing.positions @ F.T, box=packing.box.deformed(F))
    network = pj.ContactNetwork.of(moved)
    sigma = moved.radii[network.i] + moved.radii[network.j]
    return moved.potential.energy(network.distance, sigma).sum()


@pytest.mark.parametrize("strain", STRAINS)
def test_affine_stiffness_is_the_second_derivative_of_the_energy(comm, strain):
    """With pre-stress this depends on how F(s) curves."""
    packing, mode, h = jax_md(4), strain_mode(strain), 1e-4
    K, _ = dense(packing, pj.ContactDamping(), comm, mode)
    second = (energy(packing, h, mode) - 2 * energy(packing, 0, mode) + energy(packing, -h, mode)) / h**2
    assert K[-1, -1] == pytest.approx(second, rel=1e-6)

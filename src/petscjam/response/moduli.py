"""The complex modulus G*(ω) with one factorisation for each frequency, and its exact limits.

Axes: w frequency, i disk, x Cartesian.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.progress import Progress, reporting
from petscjam.base.types import Array
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve
from petscjam.parallel.memory import peak_memory
from petscjam.parallel.solver import LARGEST_RESIDUAL, DirectSolver
from petscjam.response.limits import infinite_frequency, limit_or_note, quasistatic, zero_frequency
from petscjam.response.matrices import Pencil, solving
from petscjam.response.origin import frequencies
from petscjam.response.problem import LinearProblem, describe
from petscjam.response.result import ComplexModulus
from petscjam.rows.damping import DampingLaw, law_or_default, with_law
from petscjam.rows.kinematics import SYMMETRIC_STRAINS, Field, strain_mode


@reporting
@with_law
def complex_modulus(
    packing: Packing,
    omegas: ArrayLike,
    *,
    damping: DampingLaw | str | None = None,
    strain: str = "simple-shear",
    prestress: bool = True,
    comm: Comm | None = None,
    mass: ArrayLike | None = None,
    fields_at: ArrayLike = (),
    name: str = "packing",
    progress: Progress | None = None,
) -> ComplexModulus:
    """Solve (K + iωB)q = f at each frequency (BT eqs. 10–13) and for both limits; with inertia (K + iωB − ω²M)q = f.

    Parameters
    ----------
    omegas : (W,) array_like
        Angular frequencies in 1/τ1, all > 0.
    mass : float or (N,) array_like
        Of every disk, or of each one, in units of k τ1²; their moments of inertia are mass ρ²/2 (docs/theory.md,
        Inertia). Default: no inertia.
    fields_at : array_like
        Frequencies of ``omegas`` at which displacements are stored.
    packing, damping, strain, prestress, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Raises
    ------
    InputError
        On a frequency or a mass that is not > 0, an unknown strain, a packing without a connected backbone.
    SolverError
        If a solve fails or its residual is not small.
    """
    comm = resolve(comm)
    agree(comm, packing, omegas, fields_at, damping, strain, prestress, mass)
    omega = frequencies(omegas)
    kept = frequencies(fields_at, empty=True)
    if not np.isin(kept, omega).all():
        raise InputError(f"fields: {kept[~np.isin(kept, omega)].tolist()} are not frequencies of the sweep")
    problem = LinearProblem(packing, law_or_default(damping), [strain_mode(strain)], prestress, comm, mass=mass)
    values = np.empty(len(omega), dtype=complex)
    residuals, balance = np.empty(len(omega)), np.empty(len(omega))
    fields = np.empty((len(kept), len(packing), 2), dtype=complex)
    with solving(problem, progress) as (pencil, solver):
        for w, frequency in enumerate(omega):
            q, residuals[w], coupling = _solve(problem, pencil, solver, frequency)
            values[w], balance[w] = _moduli(problem, q, frequency, coupling)
            if frequency in kept:
                fields[kept == frequency] = problem.displacement(q)
            if progress:
                progress((w + 1) / (len(omega) + 1), f"ω = {frequency:.3g}, residual {residuals[w]:.0e}")
        memory, factorisations = solver.memory, solver.factorisations
        high = limit_or_note(lambda: infinite_frequency(problem, pencil, solver), problem.notes, "G∞ and η∞")
    low = limit_or_note(lambda: zero_frequency(problem), problem.notes, "G0 and η0")
    if balance.max() > LARGEST_RESIDUAL:
        problem.notes.append(f"the error of the power balance is {balance.max():.1e}: rounding errors dominate G*")
    if progress:
        progress(1.0, f"{len(omega)} frequencies and the limits, largest residual {residuals.max():.0e}")
    return ComplexModulus(
        omega=omega,
        values=values,
        residuals=residuals,
        power_balance=balance,
        errors=np.full(len(omega), np.nan),
        part_errors=np.full((2, len(omega)), np.nan),
        G0=low.G,
        eta0=low.eta,
        G_inf=high.G,
        eta_inf=high.eta,
        limit_residuals=np.array([low.residual, high.residual]),
        negative_modes=problem.negative_modes,
        zero_modes=problem.zero_modes,
        origin=describe(problem, name, strain, problem.law),
        mass=problem.masses,
        notes=tuple(problem.notes),
        field_omega=kept,
        fields=fields,
        geometry=packing if len(kept) else None,
        performance={
            "factorisations": factorisations,
            "ranks": comm.size,
            "mumps_MB": memory,
            "peak_MB": comm.allgather(peak_memory()),
        },
    )


def elastic_constants(packing: Packing, *, prestress: bool = True, comm: Comm | None = None) -> Array:
    """Return the elastic constants (3, 3) over (xx, yy, xy): C_abcd = ∂²U/∂ε_ab∂ε_cd / V, relaxed.

    They are second derivatives with respect to the symmetric linear strain F = 1 + ε, so with
    pre-stress C_xyxy exceeds the simple-shear modulus by (3p_yy − p_xx)/4.

    Parameters
    ----------
    packing : Packing
    prestress : bool
        Keep the second term of BT eq. 4.
    comm : MPI communicator
        Default: COMM_SELF.

    Raises
    ------
    SolverError
        If K is singular on the backbone.
    """
    comm = resolve(comm)
    agree(comm, packing, prestress)
    problem = LinearProblem.elastic(packing, prestress, comm, *SYMMETRIC_STRAINS)
    fields, _ = quasistatic(problem)
    for note in problem.notes:
        warnings.warn(f"elastic constants: {note}", stacklevel=2)
    motions = list(zip(fields, np.eye(3), strict=True))
    C = [[problem.product(problem.K_backbone, a, b).real for b in motions] for a in motions]
    return np.array(C) / packing.box.area


def _solve(problem: LinearProblem, pencil: Pencil, solver: DirectSolver, omega: float) -> tuple[Field, float, complex]:
    """Return q, its residual, and A_γu·q."""
    solver.factor(pencil.combine(*problem.coefficients(omega)))
    forcing = (pencil.k + 1j * omega * pencil.b)[:, 0]
    x, residual = solver.solve(-forcing)
    return pencil.dofs.gather(x, problem.comm), residual, problem.comm.allreduce(complex(forcing @ x))


def _moduli(problem: LinearProblem, q: Field, omega: float, coupling: complex) -> tuple[complex, float]:
    """Return G* from the power balance, and its difference from the Schur complement."""
    motion = (q, [1.0])
    K = problem.product(problem.K, motion, motion).real
    B = problem.product(problem.B, motion, motion).real
    for M in problem.inertia:
        K -= omega**2 * problem.product(M, motion, motion).real
    energy = K + 1j * omega * B
    schur = problem.affine[0] + 1j * omega * problem.affine[1] + coupling
    return problem.modulus(energy), abs(schur - energy) / (abs(energy) or 1.0)

"""The slowest relaxations of (K, B): B v = τ K v, the motions behind the poles of G*.

Axes: m mode, i disk of the backbone, x Cartesian, n local rows.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petscjam.box import Array, Integers
from petscjam.damping import DampingLaw, law_or_default
from petscjam.errors import InputError, SolverError
from petscjam.kinematics import strain_mode
from petscjam.packing.packing import Packing
from petscjam.parallel.comm import resolve, total
from petscjam.parallel.eigen import largest_pairs
from petscjam.parallel.memory import check_memory
from petscjam.parallel.petsc import destroying, petsc
from petscjam.parallel.solver import DirectSolver, direct_solver
from petscjam.progress import Report
from petscjam.response.matrices import Pencil, assembled
from petscjam.response.modes import check, everywhere, lowest_modes, signs
from petscjam.response.problem import LinearProblem, agree, describe

INSTANT = 1e-13  # of the slowest time, below which a motion meets no friction


@dataclass(frozen=True, eq=False)
class RelaxationModes:
    """The slowest relaxations. Units: time τ1, stress k (BT) or ke/d² (VOT).

    G* = G0 + iωη∞ + Σ_m weight_m iωτ_m/(1 + iωτ_m) over all modes.

    Attributes
    ----------
    times : (M,)
        τ, descending.
    weights : (M,)
        (v·K_uγ − v·B_uγ/τ)²/V, moduli.
    vectors : (M, n, 2)
        Displacements, vᵀKv = 1; the mean over the backbone is zero, the largest component positive.
    residuals : (M,)
        ‖Bv − τKv‖/‖τKv‖.
    disks : (n,)
        Which disks of the packing these are.
    strain : str
    damping : DampingLaw
    prestress : bool
    packing : dict
        Name, checksum, particles, phi, pressure, Z, rattlers of the packing.
    geometry : Packing
    notes : tuple of str
    performance : dict
        Ranks, seconds.
    """

    times: Array
    weights: Array
    vectors: Array
    residuals: Array
    disks: Integers
    strain: str
    damping: DampingLaw
    prestress: bool
    packing: dict[str, Any]
    geometry: Packing
    notes: tuple[str, ...] = ()
    performance: dict[str, Any] = field(default_factory=dict)


def relaxation_modes(
    packing: Packing,
    count: int = 50,
    *,
    damping: DampingLaw | None = None,
    prestress: bool = True,
    strain: str = "simple-shear",
    comm: Any = None,
    name: str = "packing",
    progress: Report | None = None,
) -> RelaxationModes:
    """Return the ``count`` slowest relaxations of a packing. It is not proved that none was missed.

    θ costs no energy and follows u: B is B_uu − B_uθ B_θθ⁻¹ B_θu. Under Stokes drag the relaxations are the
    modes of K, with τ = 1/λ, and those are proved.

    Parameters
    ----------
    packing : Packing
    count : int
        At least 1; at most 2n − 2 are returned, n the disks of the backbone.
    damping : DampingLaw
        Left out: :class:`ContactDamping` with β = 1 and rotations.
    prestress : bool
        Keep the second term of BT eq. 4.
    strain : str
        ``simple-shear``, ``pure-shear`` or ``compression``: what ``weights`` answer to.
    comm : MPI communicator
        Left out: COMM_SELF. Results are the same arrays on every rank.
    name : str
        Stored with the result.
    progress : callable
        Called on every rank with a fraction and a text.

    Raises
    ------
    InputError
        On a count below 1, an unknown strain, a law that acts on contacts and on disks, or a packing without
        a connected backbone.
    SolverError
        If K is not known to be positive definite, or the eigensolver fails.
    """
    comm, start = resolve(comm), time.perf_counter()
    agree(comm, packing, count, damping, prestress, strain)
    law, mode = law_or_default(damping), strain_mode(strain)
    if law.body and (law.normal or law.tangential):
        raise InputError(f"damping: {law} acts on contacts and on disks; relaxations are of one or the other")
    problem = LinearProblem(packing, law.without_fluid(), [mode], prestress, comm)
    check(count, problem.backbone)
    for number, kind in ((problem.negative_modes, "negative"), (problem.floppy_modes, "zero")):
        if number != 0:
            many = "an unknown number of" if number is None else number
            raise SolverError(f"K has {many} {kind} modes: motions along them do not relax")
    if law.body:
        soft = lowest_modes(packing, count, prestress=prestress, strain=strain, comm=comm, progress=progress)
        times, notes = law.body / soft.eigenvalues, (*problem.notes, *soft.notes)
        vectors = soft.vectors / np.sqrt(soft.eigenvalues)[:, None, None]
        weights, residuals = soft.softening, soft.residuals / soft.eigenvalues
    else:
        times, weights, vectors, residuals = _under_contact_damping(problem, count, progress)
        notes = tuple(problem.notes)
    return RelaxationModes(
        times, weights, vectors, residuals, np.flatnonzero(problem.backbone.backbone), strain, law, prestress,
        describe(packing, problem.backbone, name), packing, notes,
        {"ranks": comm.size, "seconds": comm.bcast(time.perf_counter() - start)},
    )  # fmt: skip


def _under_contact_damping(
    problem: LinearProblem, count: int, progress: Report | None
) -> tuple[Array, Array, Array, Array]:
    """Return times, weights, vectors and residuals; B does not see translations, and one disk is held."""
    comm = problem.comm
    dofs = problem.number(problem.active)
    needs = check_memory(comm, dofs.size)
    if progress:
        progress(0.0, needs)
    with assembled(problem.K, problem.B, dofs, comm) as pencil, _eliminated(pencil, comm) as part:
        found = largest_pairs(part.B, part.K, min(count, part.K.size[0]), prefix="petscjam_relaxations_")
        k, b = (total(comm, found.vectors.T @ pull) for pull in (part.k, part.b))
        fields = np.zeros((len(pencil.k), len(found.values)), dtype=complex)
        fields[part.moves] = found.vectors
        vectors = everywhere(problem, dofs, fields)
    vectors = vectors.reshape(len(vectors), -1, 2)
    vectors = vectors - vectors.mean(1, keepdims=True)
    vectors *= signs(vectors.reshape(len(vectors), -1))[:, None, None]
    times, last = found.values, INSTANT * found.values.max()
    drag = np.divide(b, times, out=np.zeros_like(b), where=times > last)
    weights = problem.strains[0].scale * (k - drag) ** 2 / problem.packing.box.area
    return times, weights, vectors, found.residuals / np.maximum(times, last)


@dataclass(frozen=True, eq=False)
class _Eliminated:
    """K and B between displacements, θ following; ``k`` and ``b`` (n,), and which local rows they are."""

    K: Any
    B: Any
    k: Array
    b: Array
    moves: NDArray[np.bool_]


class _Following:
    """B_uu − B_uθ B_θθ⁻¹ B_θu, as a matrix of PETSc's."""

    def __init__(self, B_uu: Any, B_ur: Any, solver: DirectSolver) -> None:
        self._uu, self._ur, self._solver, self._turns = B_uu, B_ur, solver, B_ur.createVecRight()

    def mult(self, _: Any, x: Any, y: Any) -> None:
        """Apply it."""
        self._uu.mult(x, y)
        self._ur.multTranspose(x, self._turns)
        self.follow(self._turns, y)

    def follow(self, torque: Any, y: Any) -> None:
        """Subtract B_uθ B_θθ⁻¹ ``torque``."""
        torque.array[:] = -self._solver.solve(torque.array)[0]
        self._ur.multAdd(torque, y, y)

    def destroy(self, _: Any) -> None:
        """Free the vector."""
        self._turns.destroy()


@contextmanager
def _eliminated(pencil: Pencil, comm: Any) -> Iterator[_Eliminated]:
    PETSc = petsc()
    start, stop = pencil.dofs.rows_of(comm.rank)
    moves = pencil.dofs.flat[start:stop] % 3 < 2
    u, r = (
        PETSc.IS().createGeneral((start + np.flatnonzero(which)).astype(PETSc.IntType), comm=comm)
        for which in (moves, ~moves)
    )
    K, B_uu, B_ur, B_rr = (
        matrix.createSubMatrix(*sets)
        for matrix, sets in ((pencil.K, (u, u)), (pencil.B, (u, u)), (pencil.B, (u, r)), (pencil.B, (r, r)))
    )
    for square in (K, B_rr):
        square.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        square.setOption(PETSc.Mat.Option.HERMITIAN, False)
    with (
        destroying(u, r, K, B_uu, B_ur, B_rr),
        direct_solver(comm, "petscjam_rolling_", definite=True) as solver,
    ):
        solver.factor(B_rr)
        following = _Following(B_uu, B_ur, solver)
        B = PETSc.Mat().createPython(B_uu.getSizes(), following, comm=comm)
        B.setUp()
        drag, torque = B_ur.createVecLeft(), B_ur.createVecRight()
        with destroying(B, drag, torque):
            drag.array[:], torque.array[:] = pencil.b[moves, 0], pencil.b[~moves, 0]
            following.follow(torque, drag)
            yield _Eliminated(K, B, pencil.k[moves, 0], drag.array.real.copy(), moves)

"""The slowest relaxations of (K, B): B v = τ K v, the motions of the poles of G*.

Axes: m mode, i disk of the backbone, x Cartesian, n local rows.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import dia_array

from petscjam.base.errors import InputError, SolverError
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.types import Array, Integers
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve, total
from petscjam.parallel.eigen import Pairs, pencil_pairs, search_all, settled
from petscjam.parallel.memory import check_memory
from petscjam.parallel.petsc import destroying, petsc
from petscjam.parallel.solver import DirectSolver, direct_solver
from petscjam.preparation.certify import negative_pivots, pivots_below
from petscjam.response.matrices import Pencil, assembled
from petscjam.response.modes import PROVED, check, everywhere, lowest_modes, probe, signs
from petscjam.response.origin import Result, stored
from petscjam.response.problem import LinearProblem, describe
from petscjam.rows.damping import DampingLaw, law_or_default, viscous_form, with_law
from petscjam.rows.kinematics import displacements, elastic_form, strain_mode

if TYPE_CHECKING:
    from petsc4py.PETSc import Mat, Vec

INSTANT = 1e-13  # of the slowest time, below which a motion has no friction


@dataclass(frozen=True, eq=False)
class RelaxationModes(Result):
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
    complete : bool or None
        True: a count of all slower relaxations proves that none was missed; None if this is not proved; a note
        gives the reason.
    disks : (n,)
        Numbers of these disks in the packing.
    geometry : Packing
    performance : dict
        Ranks, unknowns, eigensolves and counts, seconds.
    """

    times: Array = field(metadata=stored("tau1", "M", finite=True))
    weights: Array = field(metadata=stored("stress", "M", finite=True))
    vectors: Array = field(metadata=stored(axes="M n 2", finite=True))
    residuals: Array = field(metadata=stored("1", "M"))
    complete: bool | None
    disks: Integers = field(metadata=stored(axes="n"))
    geometry: Packing
    performance: dict[str, Any] = field(default_factory=dict)
    settings: ClassVar[tuple[str, ...]] = ("strain", "damping")
    units: ClassVar[str] = "times in tau1, weights in k"
    figure: ClassVar[str] = "petscjam.plots.modes:relaxations_figure"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        return {
            "law": str(self.damping),
            "modes": f"{len(self.times)}",
            "slowest": self.times[0],
            "fastest": self.times[-1],
            "weights": float(self.weights.sum()),
            "residual": f"{self.residuals.max():.0e}",
            "complete": PROVED.get(self.complete, "not known"),
        }


@reporting
@with_law
def relaxation_modes(
    packing: Packing,
    count: int = 50,
    *,
    damping: DampingLaw | str | None = None,
    prestress: bool = True,
    strain: str = "simple-shear",
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> RelaxationModes:
    """Return the ``count`` slowest relaxations of a packing, and prove that none was missed.

    θ costs no energy and follows u: B is B_uu − B_uθ B_θθ⁻¹ B_θu. Under Stokes drag the relaxations are the
    modes of K, with τ = 1/λ. Under contact damping the pivots of one real LDLᵀ of B − τK over u and θ, τ in a
    gap below the last, count the slower ones. A set of equal times may be cut by ``count``, as in
    :func:`petscjam.lowest_modes`.

    Parameters
    ----------
    count : int
        At least 1; at most 2n − 2 are returned, n the disks of the backbone.
    damping : DampingLaw
        Default: :class:`ContactDamping` with β = 1 and rotations.
    strain : str
        ``simple-shear``, ``pure-shear`` or ``compression``: the strain mode of ``weights``.
    packing, prestress, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Raises
    ------
    InputError
        On a count below 1, an unknown strain, a law that acts both on contacts and on disks, or a packing without
        a connected backbone.
    SolverError
        If K is not known to be positive definite, or the eigensolver fails.
    """
    comm, start = resolve(comm), time.perf_counter()
    agree(comm, packing, count, damping, prestress, strain)
    law, mode = law_or_default(damping), strain_mode(strain)
    if law.body and (law.normal or law.tangential):
        raise InputError(f"damping: {law} acts on contacts and on disks; relaxations are of one or the other")
    problem = LinearProblem(packing, law, [mode], prestress, comm, fluid=False)
    check(count, problem.backbone)
    for number, kind in ((problem.negative_modes, "negative"), (problem.zero_modes, "zero")):
        if number != 0:
            many = "an unknown number of" if number is None else number
            raise SolverError(f"K has {many} {kind} modes: motions along them do not relax")
    if law.body:
        soft = lowest_modes(packing, count, prestress=prestress, strain=strain, comm=comm, progress=progress)
        root = np.sqrt(soft.eigenvalues)
        found = _Relaxations(
            law.body / soft.eigenvalues,
            soft.softening,
            soft.vectors / root[:, None, None],
            soft.residuals / soft.eigenvalues,
            soft.complete,
            soft.performance,
        )
        problem.notes = list(soft.notes)
    else:
        found = _under_contact_damping(problem, count, progress)
    performance = {**found.performance, "seconds": comm.bcast(time.perf_counter() - start)}
    return RelaxationModes(
        origin=describe(problem, name, strain, law),
        times=found.times,
        weights=found.weights,
        vectors=found.vectors,
        residuals=found.residuals,
        complete=found.complete,
        disks=np.flatnonzero(problem.backbone.backbone),
        geometry=packing,
        notes=tuple(problem.notes),
        performance=performance,
    )


class _Relaxations(NamedTuple):
    times: Array
    weights: Array
    vectors: Array
    residuals: Array
    complete: bool | None
    performance: dict[str, Any]


def _under_contact_damping(problem: LinearProblem, count: int, progress: Report | None) -> _Relaxations:
    """Return the slowest relaxations; B does not resist translations, and one disk is fixed."""
    comm = problem.comm
    dofs = problem.number(problem.active)
    needs = check_memory(comm, dofs.size)
    if progress:
        progress(0.0, needs)
    with assembled(problem.K, problem.B, dofs, comm) as pencil, _eliminated(pencil, comm) as part:
        most = part.K.size[0]
        count = min(count, most)

        def search(wanted: int, known: Array | None) -> Pairs:
            return pencil_pairs(part.minus_B, part.K, wanted, known=known, prefix="petscjam_relaxations_")

        def count_below(sigma: float, room: float) -> int:
            return _slower(problem, -sigma, room)

        def least(values: Array) -> float:
            return INSTANT * float(abs(values[0]))

        searched = search_all(search, count_below, count, most, comm, least=least, progress=progress)
        pairs, own = searched.pairs, probe(dofs, comm.rank)[part.moves]
        found = settled(part.minus_B, part.K, pairs, count, own, least(pairs.values))
        k, b = (total(comm, found.vectors.T @ coupling) for coupling in (part.k, part.b))
        fields = np.zeros((len(pencil.k), count), dtype=complex)
        fields[part.moves] = found.vectors
        vectors = everywhere(problem, dofs, fields)
    vectors = vectors.reshape(len(vectors), -1, 2)
    vectors = vectors - vectors.mean(1, keepdims=True)
    vectors *= signs(vectors.reshape(len(vectors), -1))[:, None, None]
    times, last = -found.values, least(found.values)
    drag = np.divide(b, times, out=np.zeros_like(b), where=times > last)
    weights = problem.strains[0].scale * (k - drag) ** 2 / problem.packing.box.area
    problem.notes += searched.notes
    return _Relaxations(
        times,
        weights,
        vectors,
        found.residuals / np.maximum(times, last),
        searched.complete,
        comm.bcast({"ranks": comm.size, "unknowns": dofs.size, **searched.performance}),
    )


def _slower(problem: LinearProblem, tau: float, room: float) -> int:
    """Return the number of times above ``tau``; those within ``room`` of it may be counted or not.

    They are the positive eigenvalues of S − τK, S = B_uu − B_uθ B_θθ⁻¹ B_θu (Sylvester). This is a Schur
    complement in B − τK over u and θ, which has one more for each θ (Haynsworth, Linear Algebra Appl. 1, 73,
    1968). A factorisation with a rounding error below the lowest eigenvalue of ¼(room/τ)(τK + B) is exact for a τ
    that differs by less than ``room``. The unknowns are scaled to a unit diagonal of τK + B.

    Raises
    ------
    SolverError
        If a factorisation fails, or its rounding error is larger.
    """
    everybody = np.ones(len(problem.packing), dtype=bool)
    unknowns = np.flatnonzero(problem.active)
    K = elastic_form(problem.network, everybody, problem.strains, prestress=problem.prestress)
    B = viscous_form(problem.network, everybody, problem.strains, problem.law)
    K, B = (form.matrices(unknowns)[0] for form in (K, B))
    scale = max(abs(tau), room)
    both = scale * K + B
    root = dia_array((both.diagonal()[None] ** -0.5, [0]), shape=both.shape)
    positive, rounding = negative_pivots(root @ (tau * K - B) @ root)
    lowest = 4 * rounding * scale / room
    if pivots_below(root @ both @ root, 2 * lowest, lowest) > 0:
        raise SolverError(f"the rounding error of the factorisation of K and B exceeds {room / scale:.1e} of τ")
    return positive - int(problem.active[:, 2].sum())


@dataclass(frozen=True, eq=False)
class _Eliminated:
    """K and −B between displacements, θ following; ``k`` and ``b`` (n,), and their local rows."""

    K: Mat
    minus_B: Mat
    k: Array
    b: Array
    moves: NDArray[np.bool_]


class _Following:
    """B_uθ B_θθ⁻¹ B_θu − B_uu, as a matrix of PETSc's."""

    def __init__(self, B_uu: Mat, B_ur: Mat, solver: DirectSolver) -> None:
        self._uu, self._ur, self._solver, self._turns = B_uu, B_ur, solver, B_ur.createVecRight()

    def mult(self, _: Mat, x: Vec, y: Vec) -> None:
        """Apply it."""
        self._uu.mult(x, y)
        self._ur.multTranspose(x, self._turns)
        self.follow(self._turns, y)
        y.scale(-1.0)

    def follow(self, torque: Vec, y: Vec) -> None:
        """Subtract B_uθ B_θθ⁻¹ ``torque``."""
        torque.array[:] = -self._solver.solve(torque.array)[0]
        self._ur.multAdd(torque, y, y)

    def destroy(self, _: Mat) -> None:
        """Free the vector."""
        self._turns.destroy()


@contextmanager
def _eliminated(pencil: Pencil, comm: Comm) -> Iterator[_Eliminated]:
    PETSc = petsc()
    start, _ = pencil.dofs.rows_of(comm.rank)
    moves = pencil.dofs.scatter(displacements(np.ones(len(pencil.dofs.index), dtype=bool)), comm.rank)
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
    with destroying(u, r, K, B_uu, B_ur, B_rr), direct_solver(comm, "petscjam_rolling_", definite=True) as solver:
        solver.factor(B_rr)
        following = _Following(B_uu, B_ur, solver)
        minus_B = PETSc.Mat().createPython(B_uu.getSizes(), following, comm=comm)
        minus_B.setUp()
        drag, torque = B_ur.createVecLeft(), B_ur.createVecRight()
        with destroying(minus_B, drag, torque):
            drag.array[:], torque.array[:] = pencil.b[moves, 0], pencil.b[~moves, 0]
            following.follow(torque, drag)
            yield _Eliminated(K, minus_B, pencil.k[moves, 0], drag.array.real.copy(), moves)

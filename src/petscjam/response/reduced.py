"""The reduced model of (K, B): responses at a few frequencies, chosen one by one until the certificate holds.

Every rank holds its rows of the motions and the same small matrices between them (docs/theory.md, Reduced
model).

Axes: n local rows, m motion (0 is Q₀, with strain 1), k node.
"""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petscjam.box import Array
from petscjam.damping import DampingLaw, law_or_default
from petscjam.errors import InputError
from petscjam.kinematics import Motion, strain_mode
from petscjam.packing.packing import Packing
from petscjam.parallel.comm import resolve, total
from petscjam.parallel.solver import DirectSolver, direct_solver
from petscjam.progress import Report
from petscjam.response.dofs import free_motions, sees
from petscjam.response.limits import infinite_frequency, limit_or_note, zero_frequency
from petscjam.response.matrices import Pencil, assembled
from petscjam.response.problem import LinearProblem, agree, describe
from petscjam.response.spectrum import Spectrum

PER_DECADE = 32  # frequencies at which the certificate is asked for
EVERY = 4  # and every so many of them may become a node
ORDER = 2  # a node gives q and dq/dω; at the ends of the span q alone
MOST_NODES = 40
NEW = 1e-10  # part of a vector outside the others, below which it is rounding
PLATEAU = 1e-3  # distance of a limit from the end of the span, relative, above which it is solved for
SILENT = 1e-13  # residual, relative to the forcing, below which there is no more to learn

Complex = NDArray[np.complex128]


def spectrum(
    packing: Packing,
    span: tuple[float, float] = (1e-8, 1e2),
    *,
    damping: DampingLaw | None = None,
    strain: str = "simple-shear",
    prestress: bool = True,
    rtol: float = 1e-6,
    comm: Any = None,
    displacements: bool = True,
    name: str = "packing",
    progress: Report | None = None,
    **solver_options: Any,
) -> Spectrum:
    """Return G*(ω) at every frequency of ``span`` from a few factorisations, with a bound on its error.

    A Galerkin projection of (K, B) on the responses at frequencies chosen where the bound is worst, until it
    is below ``rtol`` everywhere (docs/theory.md, Reduced model). It does not depend on the number of ranks.

    Parameters
    ----------
    packing : Packing
    span : (float, float)
        Lowest and highest angular frequency, 1/τ1.
    damping : DampingLaw
        Left out: :class:`ContactDamping` with β = 1 and rotations.
    strain : str
        ``simple-shear``, ``pure-shear`` or ``compression`` (the complex bulk modulus).
    prestress : bool
        Keep the second term of BT eq. 4.
    rtol : float
        Of |ΔG*|/|G*|, between 1e-12 and 0.1. Where rounding alone exceeds it, a note says so.
    comm : MPI communicator
        Left out: COMM_SELF. The result is the same on every rank.
    displacements : bool
        Keep the motions, (M, N, 2) numbers on every rank, for :meth:`Spectrum.displacement`.
    name : str
        Stored with the result.
    progress : callable
        Called on every rank with a fraction and a text.
    **solver_options
        ``out_of_core`` and ``block_low_rank`` of :func:`petscjam.parallel.solver.direct_solver`.

    Raises
    ------
    InputError
        On a span that is not 0 < low ≤ high, an unknown strain, a packing without a connected backbone.
    SolverError
        If a solve fails.
    """
    comm, start = resolve(comm), time.perf_counter()
    agree(comm, packing, tuple(span), damping, strain, prestress, rtol)
    low, high = (float(end) for end in span)
    if not 0 < low <= high < np.inf:
        raise InputError(f"span: frequencies must be 0 < low ≤ high, not {low:g} and {high:g}")
    if not 1e-12 <= rtol <= 0.1:
        raise InputError(f"rtol: must be between 1e-12 and 0.1, not {rtol:g}")
    law = law_or_default(damping)
    problem = LinearProblem(packing, law, [strain_mode(strain)], prestress, comm)
    dofs = problem.number(problem.active)
    with (
        assembled(problem.K, problem.B, dofs, comm) as pencil,
        direct_solver(comm, "petscjam_", definite=problem.definite, **solver_options) as solver,
    ):
        grow = _Projection(problem, pencil, solver)
        make = partial(
            Spectrum, span=(low, high), rtol=rtol, limits=np.full((2, 2), np.nan),
            limit_errors=np.full((2, 2), np.nan), forcing=grow.forcing, affine=problem.affine,
            area=packing.box.area, pressure=problem.pressure, definite=problem.definite,
            negative_modes=None if problem.modes is None else problem.modes[0], strain=strain, damping=law,
            prestress=prestress, packing=describe(packing, problem.backbone, name),
        )  # fmt: skip
        model = _until_certified(grow, make, progress)
        limits, limit_errors = model.own_limits()
        if not limit_errors[1].max() < PLATEAU:
            found = limit_or_note(
                lambda: infinite_frequency(problem, pencil, solver), problem.notes, "G∞ and η∞"
            )
            limits[1], limit_errors[1] = (found.G, found.eta), found.residual
        motions = grow.displacements() if displacements else None
        performance = {
            "factorisations": len(grow.nodes), "ranks": comm.size, "unknowns": dofs.size,
            "mumps_MB": solver.memory, "flops": solver.flops, "residual": grow.residual,
        }  # fmt: skip
    if not limit_errors[0].max() < PLATEAU:
        found = limit_or_note(lambda: zero_frequency(problem), problem.notes, "G0 and η0")
        limits[0], limit_errors[0] = (found.G, found.eta), found.residual
    performance["peak_MB"] = comm.allgather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    performance["seconds"] = comm.bcast(time.perf_counter() - start)
    return replace(
        model, limits=comm.bcast(limits), limit_errors=comm.bcast(limit_errors), notes=tuple(problem.notes),
        performance=performance, motions=motions, geometry=packing if displacements else None,
    )  # fmt: skip


def _until_certified(grow: _Projection, make: partial[Spectrum], progress: Report | None) -> Spectrum:
    """Add nodes where the bound is worst until it is met, or cannot be; return the model."""
    (low, high), rtol, comm = make.keywords["span"], make.keywords["rtol"], grow.problem.comm
    grid = np.geomspace(low, high, 1 + int(np.ceil(PER_DECADE * np.log10(high / low))))
    candidates = grid[EVERY:-EVERY:EVERY] if len(grid) > 2 * EVERY else grid[1:-1]
    for omega in np.unique([low, high]):
        grow.add(omega, order=1)
    while True:
        model = make(**comm.bcast(grow.model(grid)))
        bound = comm.bcast(model.truncation(grid))
        if bound.max() <= rtol:
            model = replace(model, gain_errors=comm.bcast(grow.gain_errors(model)))
            bound = comm.bcast(model.truncation(grid))
        worst = float(bound.max())
        if progress:
            done = np.clip(np.log(max(worst, rtol / 10)) / np.log(rtol), 0, 1) if worst < 1 else 0.0
            progress(float(done), f"{len(grow.nodes)} factorisations, |G*| within {worst:.0e}")
        fresh = candidates[~np.isin(candidates, model.nodes)]
        if worst <= rtol or len(fresh) == 0 or len(grow.nodes) == MOST_NODES:
            break
        there = np.nan_to_num(model.truncation(fresh), nan=np.inf)
        grow.add(comm.bcast(float(fresh[np.argmax(there)])), order=ORDER)
    floor = float(model.error(grid).max())
    if not worst <= rtol:
        grow.problem.notes.append(f"rtol = {rtol:g} is not met: the certificate says {worst:.1e}")
    elif floor > rtol:
        grow.problem.notes.append(f"rounding is the floor: the certificate says {floor:.1e}")
    return model


@dataclass(eq=False)
class _Node:
    """A frequency, the last vector t that its factor gave, and the forces Vᵀ(K + iωB)t."""

    omega: float
    order: int
    top: Complex
    forces: Complex


class _Projection:
    """Motions, and the pencil between them; one factor at a time lives in ``solver``."""

    def __init__(self, problem: LinearProblem, pencil: Pencil, solver: DirectSolver) -> None:
        self.problem, self.pencil, self.solver = problem, pencil, solver
        self.k, self.b = pencil.k[:, 0], pencil.b[:, 0]
        self.forcing = (float(self._norm(self.k)), float(self._norm(self.b)))
        self.residual = 0.0
        self.nodes: list[_Node] = []
        self.offset: Array | None = None
        self.blocks: list[Array] = []  # (n, ≤ 4) each, orthonormal together
        self.K = self.B = np.zeros((0, 0))
        self._vectors = pencil.K.createVecs()
        self._free = self._unseen_by_K()

    # ---- nodes

    def add(self, omega: float, order: int) -> None:
        """Factor K + iωB, and add q and its derivatives below ``order`` to the motions."""
        self.solver.factor(self.pencil.combine(1, 1j * omega))
        q = self._solve(-(self.k + 1j * omega * self.b), drag=self.b)
        Bq = self._apply(self.pencil.B, q)
        if self.offset is None:
            self._start(q.real)
            new = [q.imag]
        else:
            new = [q.real - self.offset, q.imag]
        top = self._solve(self.b + Bq)
        forces = self.b + Bq
        for _ in range(order - 1):
            new += [top.real, top.imag]
            forces = self._apply(self.pencil.B, top)
            top = self._solve(forces)
        self._extend(new)
        self.nodes.append(_Node(omega, order, top, self._on_motions(forces)))

    def _solve(self, rhs: Complex, drag: Array | float = 0.0) -> Complex:
        """Solve with the present factor, and take out what only rounding moves.

        K ignores a free motion e that B sees, so eᵀ(Bx + drag) = 0; at low ω rounding would outgrow that.
        """
        x, residual = self.solver.solve(rhs)
        self.residual = max(self.residual, residual)
        for e, Be, eBe in self._free:
            x = x - e * ((self._dot(Be, x) + self._dot(e, np.zeros_like(e) + drag)) / eBe)
        return x

    def _unseen_by_K(self) -> list[tuple[Array, Array, float]]:
        problem, found = self.problem, []
        for motion in free_motions(problem.network)[:2]:
            if sees(problem.B, motion, problem.comm):
                e = self.pencil.dofs.scatter(motion * problem.active, problem.comm.rank).real
                Be = self._apply(self.pencil.B, e + 0j).real
                found.append((e, Be, float(self._dot(e, Be))))
        return found

    # ---- motions

    def _start(self, q: Array) -> None:
        """Make q with strain 1 the first motion."""
        problem = self.problem
        self.offset = q.copy()
        Q: Motion = (self.pencil.dofs.gather(q, problem.comm), [1.0])
        self.K, self.B = (
            np.array([[problem.product(form, Q, Q).real]]) for form in (problem.K, problem.B)
        )  # sums over contacts: nothing cancels
        self._force_K = self.k + self._apply(self.pencil.K, q + 0j).real
        self._force_B = self.b + self._apply(self.pencil.B, q + 0j).real

    def _extend(self, vectors: list[Array]) -> None:
        """Add what is new in ``vectors`` to the motions, and its rows to K, B and the nodes."""
        fresh = self._orthonormal(vectors)
        if fresh.shape[1] == 0:
            return
        products = []
        for name, matrix, pull in (("K", self.pencil.K, self._force_K), ("B", self.pencil.B, self._force_B)):
            forces = self._apply_real(matrix, fresh)
            across = np.vstack([self._dot(pull, fresh), self._on_motions(forces)])
            own = self._dot(fresh, forces)
            setattr(self, name, np.block([[getattr(self, name), across], [across.T, (own + own.T) / 2]]))
            products.append(forces)
        for node in self.nodes:
            new = self._dot(products[0] + 1j * node.omega * products[1], node.top)
            node.forces = np.append(node.forces, new)
        self.blocks.append(fresh)

    def _orthonormal(self, vectors: list[Array]) -> Array:
        """Return what is new in ``vectors``, orthogonal to the motions and to each other, as columns."""
        fresh = np.empty((len(self.k), 0))
        for vector in vectors:
            v, size = vector, self._norm(vector)
            for attempt in range(3):  # the last one after normalising
                for block in (*self.blocks, fresh):
                    v = v - block @ self._dot(block, v)
                left = self._norm(v)
                if not left > NEW * size:
                    break
                if attempt:
                    v = v / left
            else:
                fresh = np.column_stack([fresh, v])
        return fresh

    def displacements(self) -> Array:
        """Return the displacements of all motions, (M, N, 2), on every rank."""
        problem, columns = self.problem, [self.offset, *(v for block in self.blocks for v in block.T)]
        gathered = (self.pencil.dofs.gather(np.asarray(v, dtype=complex), problem.comm) for v in columns)
        return np.array([problem.displacement(q).real for q in gathered])

    # ---- the certificate

    def model(self, grid: Array) -> dict[str, Any]:
        """Return the arrays of a :class:`Spectrum`: the pencil, the residual, the gains."""
        R = self._direction(grid)
        KR, BR = self._apply(self.pencil.K, R + 0j).real, self._apply(self.pencil.B, R + 0j).real
        residual_K = np.concatenate([[self._dot(R, self._force_K)], self._on_motions(KR)])
        residual_B = np.concatenate([[self._dot(R, self._force_B)], self._on_motions(BR)])
        gains = np.zeros(len(self.nodes), dtype=complex)
        if self._norm(R) > 0:
            for k, node in enumerate(self.nodes):
                y = self._correction(node)
                length = self._dot(KR + 1j * node.omega * BR, node.top)
                length = length + (residual_K + 1j * node.omega * residual_B)[1:] @ y
                gains[k] = self._dot(R, node.top) / length
        wrong = np.maximum(-gains.real, gains.imag).clip(0) * self.problem.definite  # signs are known there
        with np.errstate(divide="ignore", invalid="ignore"):
            gain_errors = np.where(wrong > 0, wrong / abs(gains), 0.0)
        return {
            "K": self.K, "B": self.B, "residual_K": residual_K, "residual_B": residual_B, "gains": gains,
            "gain_errors": gain_errors, "nodes": np.array([node.omega for node in self.nodes]),
        }  # fmt: skip

    def gain_errors(self, trial: Spectrum) -> Array:
        """Return for each node the part of its own residual that is not along R: rounding, if small."""
        errors = np.zeros(len(self.nodes))
        if not trial.gains.any():
            return errors
        R = self._R
        for k, node in enumerate(self.nodes):
            z = node.top + self._combine(self._correction(node))
            r = self._apply(self.pencil.K, z) + 1j * node.omega * self._apply(self.pencil.B, z)
            errors[k] = self._norm(r - R * self._dot(R, r)) / self._norm(r)
        return errors

    def _correction(self, node: _Node) -> Complex:
        """Return the motions that Galerkin would add to ``node.top``."""
        A = self.K[1:, 1:] + 1j * node.omega * self.B[1:, 1:]
        return -np.linalg.solve(A, node.forces) if len(A) else np.zeros(0, dtype=complex)

    def _direction(self, grid: Array) -> Array:
        """Return R, the direction of the residual at every ω, or zero where there is none."""
        omega = self._loudest(grid)
        A = self.K + 1j * omega * self.B
        y = -np.linalg.solve(A[1:, 1:], A[1:, 0]) if len(A) > 1 else np.zeros(0, dtype=complex)
        u = self._combine(y)
        r = self._force_K + self._apply(self.pencil.K, u)
        r = r + 1j * omega * (self._force_B + self._apply(self.pencil.B, u))
        size = self._norm(r)
        if not size > SILENT * np.hypot(self.forcing[0], omega * self.forcing[1]):
            self._R = np.zeros(len(r))
            return self._R
        R = (r * np.exp(-0.5j * np.angle(self._dot(r, r)))).real
        for _ in range(2):
            for block in self.blocks:
                R = R - block @ self._dot(block, R)
        self._R = R / self._norm(R)
        return self._R

    def _loudest(self, grid: Array) -> float:
        """Return where the residual is largest by its zeros, the nodes, and its poles, those of the model."""
        from scipy.linalg import eigvals

        with np.errstate(divide="ignore", invalid="ignore"):
            log = -np.log(np.hypot(self.forcing[0], grid * self.forcing[1]))
            for rate in eigvals(self.K[1:, 1:], self.B[1:, 1:]) if len(self.K) > 1 else ():
                if np.isfinite(rate):
                    log -= np.log(abs(rate + 1j * grid))
            for node in self.nodes:
                log += node.order * np.log(abs(grid**2 - node.omega**2))
        return float(grid[np.argmax(np.where(np.isfinite(log), log, -np.inf))])

    # ---- distributed vectors

    def _apply(self, matrix: Any, z: Complex) -> Complex:
        x, y = self._vectors
        x.array[:] = z
        matrix.mult(x, y)
        return y.array.copy()

    def _apply_real(self, matrix: Any, columns: Array) -> Array:
        """Return ``matrix`` times real columns, two at a time: K and B are real."""
        out = np.empty_like(columns)
        for first in range(0, columns.shape[1], 2):
            pair = columns[:, first : first + 2]
            product = self._apply(matrix, pair[:, 0] + 1j * pair[:, -1])
            out[:, first] = product.real
            if pair.shape[1] == 2:
                out[:, first + 1] = product.imag
        return out

    def _combine(self, y: Complex) -> Complex:
        out, start = np.zeros(len(self.k), dtype=complex), 0
        for block in self.blocks:
            part = y[start : start + block.shape[1]]
            out += block @ part.real + 1j * (block @ part.imag)
            start += block.shape[1]
        return out

    def _on_motions(self, force: NDArray) -> NDArray:
        """Return Vᵀ force, for the motions without strain."""
        none = np.zeros((0, *force.shape[1:]), dtype=force.dtype)
        return np.concatenate([none, *(self._dot(block, force) for block in self.blocks)])

    def _dot(self, a: NDArray, b: NDArray) -> Any:
        """Return aᵀb over all ranks, nothing conjugated."""
        if np.iscomplexobj(b) and not np.iscomplexobj(a):
            return total(self.problem.comm, a.T @ b.real + 1j * (a.T @ b.imag))
        return total(self.problem.comm, a.T @ b)

    def _norm(self, a: NDArray) -> float:
        return float(np.sqrt(total(self.problem.comm, np.vdot(a, a).real)))

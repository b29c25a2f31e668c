"""The motions that span a reduced model, distributed over the ranks, and the forms between them.

The first one, Q₀, has strain 1; the others have none and are orthonormal.

Axes: n local rows, m motion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from petscjam.base.types import Array
from petscjam.parallel.comm import total
from petscjam.parallel.matrix import apply_real
from petscjam.parallel.solver import Complex, DirectSolver
from petscjam.response.dofs import connected, resists
from petscjam.response.matrices import Pencil
from petscjam.response.problem import LinearProblem
from petscjam.rows.kinematics import Motion, translations

if TYPE_CHECKING:
    from petsc4py.PETSc import Mat

NEW = 1e-10  # relative component of a vector outside the others, below which it is a rounding error


class ReducedBasis:
    """A growing basis, and each form of ``pencil`` between its motions; ``solver`` has the factor of a node.

    Attributes
    ----------
    reduced : list of (M, M)
        Each form between the motions.
    forces : list of (n,)
        This rank's rows of each form times Q₀.
    residual : float
        Largest residual of a solve.
    """

    def __init__(self, problem: LinearProblem, pencil: Pencil, solver: DirectSolver) -> None:
        self.problem, self.pencil, self.solver = problem, pencil, solver
        self.coupling = [coupling[:, 0] for coupling in pencil.coupling]
        self.reduced: list[Array] = []
        self.forces: list[Array] = []
        self.residual = 0.0
        self._offset: Array | None = None
        self._blocks: list[Array] = []  # columns, a block for each node, to avoid copies
        self._free = self._resisted_translations()

    def solve(self, rhs: Complex, drag: Array | float = 0.0) -> Complex:
        """Solve with the current factor, and remove the error by rounding from the solution.

        K does not resist a translation e, so eᵀ(Bx + drag) = 0; at low ω rounding errors would violate this.

        Parameters
        ----------
        rhs : (n,)
            This rank's rows.
        drag : (n,), optional
            B times the motion apart from x.
        """
        x, residual = self.solver.solve(rhs, soft=True)
        self.residual = max(self.residual, residual)
        for e, Be, eBe in self._free:
            x = x - e * ((self.dot(Be, x) + self.dot(e, np.zeros_like(e) + drag)) / eBe)
        return x

    def _resisted_translations(self) -> list[tuple[Array, Array, float]]:
        """Return e, Be and eᵀBe for each translation of connected disks that B resists; K resists none."""
        problem, found = self.problem, []
        for motion in translations(len(problem.packing)):
            if not resists(problem.B, motion, problem.comm):
                continue
            for disks in connected(problem.network):
                e = self.pencil.dofs.scatter(motion * problem.active * disks[:, None], problem.comm.rank)
                Be = self.apply(self.pencil.B, e + 0j).real
                found.append((e, Be, float(self.dot(e, Be))))
        return found

    def new_motions(self, q: Complex) -> list[Array]:
        """Return q − Q₀, real and imaginary part, of the response ``q`` at unit strain; the first real part is Q₀."""
        if self._offset is not None:
            return [q.real - self._offset, q.imag]
        self._offset = q.real.copy()
        problem = self.problem
        Q: Motion = (self.pencil.dofs.gather(self._offset, problem.comm), [1.0])
        for form, matrix, coupling in zip(self.pencil.forms, self.pencil.matrices, self.coupling, strict=True):
            # a sum over contacts, without cancellation
            self.reduced.append(np.array([[problem.product(form, Q, Q).real]]))
            self.forces.append(coupling + self.apply(matrix, self._offset.astype(complex)).real)
        return [q.imag]

    def extend(self, vectors: list[Array]) -> list[Array]:
        """Add the part of ``vectors`` outside the basis to it; return each form times the added motions, (n, new)."""
        fresh = self._orthonormal(vectors)
        products = [apply_real(matrix, fresh) for matrix in self.pencil.matrices]
        for k, (product, force) in enumerate(zip(products, self.forces, strict=True)):
            across = np.vstack([self.dot(force, fresh), self.on_motions(product)])
            own = self.dot(fresh, product)
            self.reduced[k] = np.block([[self.reduced[k], across], [across.T, (own + own.T) / 2]])
        self._blocks.append(fresh)
        return products

    def _orthonormal(self, vectors: list[Array]) -> Array:
        """Return the part of ``vectors`` outside the basis, orthonormal, as columns."""
        fresh = np.empty((len(self.coupling[0]), 0))
        for vector in vectors:
            v, size = vector, self.norm(vector)
            for attempt in range(3):  # the last one after normalising
                v = self.outside(v, fresh)
                left = self.norm(v)
                if not left > NEW * size:
                    break
                if attempt:
                    v, size = v / left, 1.0
            else:
                fresh = np.column_stack([fresh, v])
        return fresh

    def outside(self, v: Array, *further: Array) -> Array:
        """Return ``v`` without its components along the motions and along the columns of ``further``."""
        for block in (*self._blocks, *further):
            v = v - block @ self.dot(block, v)
        return v

    def displacements(self) -> Array:
        """Return the displacements of all motions, (M, N, 2), on every rank."""
        problem, columns = self.problem, [self._offset, *(v for block in self._blocks for v in block.T)]
        gathered = (self.pencil.dofs.gather(np.asarray(v, dtype=complex), problem.comm) for v in columns)
        return np.array([problem.displacement(q).real for q in gathered])

    def performance(self, factorisations: int) -> dict[str, Any]:
        """Return the cost of the model, for the record of a result."""
        return {
            "factorisations": factorisations,
            "ranks": self.problem.comm.size,
            "unknowns": self.pencil.dofs.size,
            "mumps_MB": self.solver.memory,
            "flops": self.solver.flops,
            "residual": self.residual,
        }

    def apply(self, matrix: Mat, z: Complex) -> Complex:
        """Return ``matrix`` times ``z``, this rank's rows.

        Parameters
        ----------
        matrix : PETSc.Mat
        z : (n,)
            This rank's rows.

        Returns
        -------
        (n,)
        """
        x, y = self.pencil.vectors
        x.array[:] = z
        matrix.mult(x, y)
        return y.array.copy()

    def combine(self, y: Complex) -> Complex:
        """Return Σ_m y_m times the motions without strain."""
        out, start = np.zeros(len(self.coupling[0]), dtype=complex), 0
        for block in self._blocks:
            part = y[start : start + block.shape[1]]
            out += block @ part.real + 1j * (block @ part.imag)
            start += block.shape[1]
        return out

    def on_motions(self, force: NDArray[Any]) -> NDArray[Any]:
        """Return Vᵀ ``force``, for the motions without strain."""
        none = np.zeros((0, *force.shape[1:]), dtype=force.dtype)
        return np.concatenate([none, *(self.dot(block, force) for block in self._blocks)])

    def dot(self, a: NDArray[Any], b: NDArray[Any]) -> Any:
        """Return aᵀb over all ranks, without conjugation.

        Parameters
        ----------
        a, b : (n,) or (n, M)
            This rank's rows.
        """
        if np.iscomplexobj(b) and not np.iscomplexobj(a):
            return total(self.problem.comm, a.T @ b.real + 1j * (a.T @ b.imag))
        return total(self.problem.comm, a.T @ b)

    def norm(self, a: NDArray[Any]) -> float:
        """Return ‖a‖ over all ranks."""
        return float(np.sqrt(total(self.problem.comm, np.vdot(a, a).real)))

"""K and B as distributed complex PETSc matrices on one sparsity pattern, and their combinations.

Each rank builds its own rows from the contacts of its disks, without communication.

Axes: a row of a contact, s strain mode.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from petscjam.base.progress import Report
from petscjam.parallel.comm import Comm
from petscjam.parallel.matrix import symmetric_matrix
from petscjam.parallel.memory import check_memory, give_back_memory
from petscjam.parallel.petsc import destroying, petsc, stage
from petscjam.parallel.solver import DirectSolver, direct_solver
from petscjam.response.dofs import Dofs
from petscjam.response.problem import LinearProblem
from petscjam.rows.kinematics import Form

if TYPE_CHECKING:
    from petsc4py.PETSc import Mat, Vec

ROUNDING = 1e-14  # size of entries that cancel, relative to the largest one


@dataclass(frozen=True, eq=False)
class Pencil:
    """The pair (K, B) on the unknowns of ``dofs``, and further forms.

    Attributes
    ----------
    forms : tuple of Form
        K, B, ….
    matrices : tuple of PETSc.Mat
        One for each form, all on one pattern.
    A : PETSc.Mat
        The latest combination, on the same pattern.
    coupling : tuple of (local rows, S) arrays
        This rank's rows of K_uγ, B_uγ, ….
    vectors : (PETSc.Vec, PETSc.Vec)
        Work vectors: a column and a row of A.
    """

    dofs: Dofs
    forms: tuple[Form, ...]
    matrices: tuple[Mat, ...]
    A: Mat
    coupling: tuple[NDArray[Any], ...]
    vectors: tuple[Vec, Vec]

    @property
    def K(self) -> Mat:
        """The stiffness matrix."""
        return self.matrices[0]

    @property
    def B(self) -> Mat:
        """The friction matrix."""
        return self.matrices[1]

    @property
    def k(self) -> NDArray[Any]:
        """Rows of K_uγ of this rank."""
        return self.coupling[0]

    @property
    def b(self) -> NDArray[Any]:
        """Rows of B_uγ of this rank."""
        return self.coupling[1]

    def combine(self, *coefficients: complex) -> Mat:
        """Fill A with the sum of the matrices, each times its coefficient."""
        same = petsc().Mat.Structure.SAME_NONZERO_PATTERN
        self.matrices[0].copy(self.A, structure=same)
        self.A.scale(coefficients[0])
        for coefficient, matrix in zip(coefficients[1:], self.matrices[1:], strict=True):
            self.A.axpy(coefficient, matrix, structure=same)
        return self.A


@contextmanager
def assembled(K: Form, B: Form, dofs: Dofs, comm: Comm, *further: Form) -> Iterator[Pencil]:
    """Assemble this rank's rows of ``K`` and ``B``; the matrices are destroyed at the end of the context.

    Parameters
    ----------
    K, B : Form
    dofs : Dofs
    comm : MPI communicator
    *further : Form
        Their pattern must be inside that of K + iB.
    """
    with stage("assemble"):
        pencil = _assemble((K, B, *further), dofs, comm)
    give_back_memory()
    with destroying(*pencil.matrices, pencil.A, *pencil.vectors):
        yield pencil


@contextmanager
def solving(
    problem: LinearProblem, progress: Report | None = None, *further: Form, **solver_options: Any
) -> Iterator[tuple[Pencil, DirectSolver]]:
    """Yield K, B, M if there is inertia, and ``further`` forms, and a solver for their combinations.

    Parameters
    ----------
    problem : LinearProblem
    progress : callable
        Called with 0 and the memory of the factor, before the computation.
    *further : Form
        As for :func:`assembled`.
    **solver_options
        ``out_of_core`` and ``block_low_rank`` of :func:`petscjam.parallel.solver.direct_solver`.

    Raises
    ------
    InputError
        If the factor needs more memory than is free.
    """
    comm, dofs = problem.comm, problem.number(problem.moving)
    needs = check_memory(comm, dofs.size, out_of_core=bool(solver_options.get("out_of_core")))
    if progress:
        progress(0.0, needs)
    with (
        assembled(problem.K, problem.B, dofs, comm, *problem.inertia, *further) as pencil,
        direct_solver(comm, "petscjam_", definite=problem.definite and not problem.inertia, **solver_options) as solver,
    ):
        yield pencil, solver


def _assemble(forms: tuple[Form, ...], dofs: Dofs, comm: Comm) -> Pencil:
    start, stop = dofs.rows_of(comm.rank)
    (K, k), (B, b), *further = (form.matrices(dofs.flat, slice(start, stop)) for form in forms)
    both = (K + 1j * B).tocsr()  # K and B are real: as K + iB they share one pattern
    both.sort_indices()
    values = [both.data.real, both.data.imag, *(_on_pattern(rows, both) for rows, _ in further)]
    *matrices, A = (symmetric_matrix(both.indptr, both.indices, part, dofs.size, comm) for part in (*values, both.data))
    return Pencil(dofs, forms, tuple(matrices), A, (k, b, *(coupling for _, coupling in further)), A.createVecs())


def _on_pattern(rows: csr_array, pattern: csr_array) -> NDArray[Any]:
    """Return the values of ``rows`` at the entries of ``pattern``, which contains their pattern."""
    width = rows.shape[1]
    places, wanted = (
        np.repeat(np.arange(part.shape[0]) * width, np.diff(part.indptr)) + part.indices for part in (rows, pattern)
    )
    here = np.searchsorted(wanted, places).clip(max=max(len(wanted) - 1, 0))
    kept = wanted[here] == places if len(wanted) else np.zeros(len(places), dtype=bool)
    outside, largest = (abs(part).max(initial=0.0) for part in (rows.data[~kept], rows.data))
    if outside > ROUNDING * largest:
        raise ValueError("a form has entries outside the pattern of K + iB")
    values = np.zeros(len(wanted))
    values[here[kept]] = rows.data[kept]
    return values

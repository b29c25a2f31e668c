"""K and B as distributed complex PETSc matrices on one sparsity pattern, and their combinations.

Each rank builds the rows it owns from the contacts that touch its disks; nothing is communicated.

Axes: a row of a contact, s strain mode.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from petscjam.kinematics import Form
from petscjam.parallel.matrix import symmetric_matrix
from petscjam.parallel.petsc import destroying, petsc, stage
from petscjam.response.dofs import Dofs


@dataclass(frozen=True, eq=False)
class Pencil:
    """The pair (K, B) on the unknowns of ``dofs``.

    Attributes
    ----------
    K, B, A : PETSc.Mat
        ``A`` holds the latest combination, on the same pattern.
    k, b : (local rows, S)
        This rank's rows of K_uγ and B_uγ.
    """

    dofs: Dofs
    K: Any
    B: Any
    A: Any
    k: NDArray
    b: NDArray

    def combine(self, stiffness: complex, friction: complex) -> Any:
        """Fill A with ``stiffness``·K + ``friction``·B."""
        same = petsc().Mat.Structure.SAME_NONZERO_PATTERN
        self.K.copy(self.A, structure=same)
        self.A.scale(stiffness)
        self.A.axpy(friction, self.B, structure=same)
        return self.A


@contextmanager
def assembled(K: Form, B: Form, dofs: Dofs, comm: Any) -> Iterator[Pencil]:
    """Assemble this rank's rows of ``K`` and ``B``; the matrices are destroyed on leaving the context."""
    start, stop = dofs.rows_of(comm.rank)
    with stage("assemble"):
        K_rows, k = _own_rows(K, dofs, start, stop)
        B_rows, b = _own_rows(B, dofs, start, stop)
        both = (K_rows + 1j * B_rows).tocsr()  # K and B are real: as K + iB they share one pattern
        both.sort_indices()
        stiffness, friction, combination = (
            symmetric_matrix(both.indptr, both.indices, part, dofs.size, comm)
            for part in (both.data.real, both.data.imag, both.data)
        )
    with destroying(stiffness, friction, combination):
        yield Pencil(dofs, stiffness, friction, combination, k, b)


def _own_rows(form: Form, dofs: Dofs, start: int, stop: int) -> tuple[csr_array, NDArray]:
    """Return this rank's rows of Σ AᵀwA + body, and of Σ Aᵀwa."""
    A = form.rows[:, dofs.flat]
    mine = A[:, start:stop].T.tocsr()
    body = np.zeros(stop - start)
    own = dofs.index[form.my_disks, :2]
    body[own[own >= 0] - start] = form.body
    here = np.arange(stop - start)
    drag = csr_array((body, (here, here + start)), shape=(stop - start, dofs.size))
    weighted = A.multiply(form.weights[:, None]).tocsr()
    return mine @ weighted + drag, mine @ (form.weights[:, None] * form.strain_rows)

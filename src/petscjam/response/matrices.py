"""K and B as distributed complex PETSc matrices on one sparsity pattern, and their combinations.

Each rank builds the rows it owns from the contacts that touch its disks; nothing is communicated.

Axes: c contact, m local degree of freedom, s strain mode.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petscjam.kinematics import Form
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
    """Assemble this rank's rows of ``K`` and ``B``, two forms on the same contacts.

    The matrices are destroyed on leaving the context.
    """
    start, stop = dofs.rows_of(comm.rank)
    ends = np.concatenate([dofs.index[K.i], dofs.index[K.j]], axis=1)  # (C, 6)
    with stage("assemble"):
        # K and B are real: as K + iB they share one pattern and one sum over duplicates
        rows = _own_rows(ends, K.blocks() + 1j * B.blocks(), _drag(B, dofs, start, stop), start, dofs.size)
        columns = np.zeros((stop - start, K.extra.shape[0]), dtype=complex)
        own = (ends >= start) & (ends < stop)
        np.add.at(columns, ends[own] - start, (K.forcing() + 1j * B.forcing())[own])
        stiffness, friction, combination = (
            _matrix(rows.indptr, rows.indices, part, dofs, comm)
            for part in (rows.data.real, rows.data.imag, rows.data)
        )
    with destroying(stiffness, friction, combination):
        yield Pencil(dofs, stiffness, friction, combination, columns.real, columns.imag)


def _drag(B: Form, dofs: Dofs, start: int, stop: int) -> NDArray:
    """Return the body term of this rank's rows, as an imaginary diagonal."""
    drag = np.zeros(stop - start, dtype=complex)
    own = dofs.index[B.my_disks, :2]
    drag[own[own >= 0] - start] = 1j * B.body
    return drag


def _own_rows(ends: NDArray, blocks: NDArray, diagonal: NDArray, start: int, n: int) -> Any:
    """Sum the 6×6 ``blocks`` and the ``diagonal`` into this rank's rows, a SciPy CSR matrix."""
    from scipy.sparse import coo_matrix

    count = len(diagonal)
    row = np.broadcast_to(ends[:, :, None] - start, blocks.shape)
    column = np.broadcast_to(ends[:, None, :], blocks.shape)
    mine = (row >= 0) & (row < count) & (column >= 0) & (ends >= 0)[:, :, None]
    here = np.arange(count)
    entries = coo_matrix(
        (
            np.concatenate([blocks[mine], diagonal]),
            (np.concatenate([row[mine], here]), np.concatenate([column[mine], here + start])),
        ),
        shape=(count, n),
    )
    return entries.tocsr()


def _matrix(indptr: NDArray, indices: NDArray, values: NDArray, dofs: Dofs, comm: Any) -> Any:
    """Return the PETSc matrix with these local rows, flagged symmetric and not Hermitian."""
    PETSc = petsc()
    local = int(dofs.counts[comm.rank])
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), values.astype(PETSc.ScalarType))
    matrix = PETSc.Mat().createAIJ(((local, dofs.size), (local, dofs.size)), csr=csr, comm=comm)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
    matrix.setOption(PETSc.Mat.Option.HERMITIAN, False)
    return matrix

"""How close the direct sweep is to bare MUMPS, how far ahead of SciPy, and how memory falls with ranks.

    mpirun -n R python benchmarks/direct_sweep.py PACKING.h5 [FREQUENCIES]

Prints ratios, all measured in this run: the whole of complex_modulus (network, assembly, limits, count of
negative modes, sweep) per frequency, over factorising and solving the same matrix with KSP and MUMPS alone.
On one rank also SciPy's splu with its defaults over the sweep.
"""

import resource
import sys
import time

import numpy as np
from mpi4py import MPI

import petscjam as pj
from petscjam.parallel.petsc import petsc
from petscjam.response.matrices import assembled
from petscjam.response.problem import LinearProblem
from petscjam.rows.kinematics import SIMPLE_SHEAR


def bare_mumps(A, f, PETSc, repeats):
    """Seconds of each factorise-and-solve of ``A`` after the first, symbolic analysis excluded."""
    ksp = PETSc.KSP().create(A.comm)
    ksp.setType("preonly")
    ksp.pc.setType("cholesky")
    ksp.pc.setFactorSolverType("mumps")
    x, seconds = f.duplicate(), []
    for _ in range(repeats + 1):
        A.stateIncrease()
        ksp.setOperators(A)
        A.comm.tompi4py().Barrier()
        start = time.perf_counter()
        ksp.setUp()
        ksp.solve(f, x)
        seconds.append(time.perf_counter() - start)
    ksp.destroy()
    return seconds[1:]


def superlu(A, f):
    """Seconds of SciPy's splu and solve with default settings."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.linalg import splu

    matrix = csr_matrix(A.getValuesCSR()[::-1]).tocsc()
    start = time.perf_counter()
    splu(matrix).solve(f.array)
    return time.perf_counter() - start


def main():
    """Measure and print."""
    comm, PETSc = MPI.COMM_WORLD, petsc()
    packing = pj.Packing.read(sys.argv[1])
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 61
    law = pj.ContactDamping()
    network = pj.ContactNetwork.of(packing)
    problem = LinearProblem(packing, law, [SIMPLE_SHEAR], True, comm)
    with assembled(problem.K, problem.B, problem.number(problem.active), comm) as pencil:
        A = pencil.combine(1, 0.01j)
        f = A.createVecLeft()
        f.array[:] = -(pencil.k + 0.01j * pencil.b)[:, 0]
        unknowns, before = A.size[0], bare_mumps(A, f, PETSc, 5)
        start = time.perf_counter()
        g = pj.complex_modulus(packing, np.geomspace(1e-8, 1e2, count), damping=law, comm=comm)
        ours = (time.perf_counter() - start) / count
        peak = comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        bare = np.median(before + bare_mumps(A, f, PETSc, 5))
        slow = superlu(A, f) if comm.size == 1 else np.nan
    if comm.rank == 0:
        backbone = 1 - network.rattlers / len(packing)
        print(
            f"{len(packing)} disks, {100 * backbone:.1f} % in the backbone, Z = {network.Z:.2f}, "
            f"{unknowns} unknowns, {count} frequencies, {comm.size} rank(s)"
        )
        print(f"bare MUMPS, a matrix        {bare:8.3f} s")
        print(f"complex_modulus, a frequency{ours:8.3f} s   ratio {ours / bare:.3f}")
        if comm.size == 1:
            print(f"SciPy splu, a matrix        {slow:8.3f} s   ratio {slow / ours:.1f}")
        print(f"MUMPS memory, largest rank  {g.performance['mumps_MB']:8.0f} MB")
        print("peak memory of each rank   ", *(f"{mb:.0f}" for mb in peak), "MB")


if __name__ == "__main__":
    main()

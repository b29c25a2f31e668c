"""The lowest modes against bare MUMPS, as a ratio, split into eigensolve and proof that none is missing.

    mpirun -n R python benchmarks/modes.py PACKING.h5 [--count 50] [--law contact]

All is measured in this run, imports excluded: bare MUMPS is KSP with PETSc's defaults, factorise and solve,
on the same K, shifted below zero, the median of ten, half of them after the rest; symbolic analysis excluded.
"""

import argparse
import resource
import time

import numpy as np
from direct_sweep import bare_mumps
from mpi4py import MPI

import petscjam as pj
from petscjam.parallel.petsc import petsc
from petscjam.response.matrices import assembled
from petscjam.response.modes import lowest_modes
from petscjam.response.problem import LinearProblem
from petscjam.response.relaxations import relaxation_modes
from petscjam.rows.damping import LAWS, ContactDamping
from petscjam.rows.kinematics import SIMPLE_SHEAR


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("packing")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--law", choices=LAWS, help="also the slowest relaxations under it")
    options = parser.parse_args()
    comm, PETSc, packing = MPI.COMM_WORLD, petsc(), pj.Packing.read(options.packing)
    lowest_modes(pj.prepare_packing(64, 1e-2, 1), 4, comm=comm)  # imports
    problem = LinearProblem(packing, ContactDamping(), [SIMPLE_SHEAR], True, comm)
    dofs = problem.number(np.outer(problem.backbone.backbone, [True, True, False]))
    with assembled(problem.K, problem.B, dofs, comm) as pencil:
        A = pencil.combine(1, 0)
        A.shift(1e-6)
        f = A.createVecLeft()
        f.array[:] = -pencil.k[:, 0]
        before = bare_mumps(A, f, PETSc, 5)
        m = lowest_modes(packing, options.count, comm=comm)
        bare = np.median(before + bare_mumps(A, f, PETSc, 5))
    times = {
        "eigensolve": m.performance["eigensolve_seconds"],
        "count": m.performance["count_seconds"],
        "all of lowest_modes": m.performance["seconds"],
    }
    if options.law:
        start = time.perf_counter()
        relaxation_modes(packing, options.count, damping=LAWS[options.law](), comm=comm)
        times[f"relaxations, {options.law}"] = time.perf_counter() - start
    peak = comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    if comm.rank == 0:
        print(f"{len(packing)} disks, {dofs.size} unknowns, {len(m.eigenvalues)} modes, {comm.size} rank(s)")
        print(f"bare MUMPS, a matrix  {bare:8.3f} s")
        for what, seconds in times.items():
            print(f"{what:21s} {seconds:8.2f} s   {seconds / bare:6.1f} × bare MUMPS")
        print(f"complete: {m.complete}, largest residual {(m.residuals / abs(m.eigenvalues)).max():.1e} of λ")
        print("peak memory of each rank", *(f"{mb:.0f}" for mb in peak), "MB")


if __name__ == "__main__":
    main()

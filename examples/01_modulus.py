"""G*(ω) of a packing just above jamming: prepare, solve, print the limits.

mpirun -n 2 python -m mpi4py examples/01_modulus.py    (-m mpi4py: an error on one rank ends both)
"""

import numpy as np
from mpi4py import MPI

import petscjam as pj

comm = MPI.COMM_WORLD
packing = comm.bcast(pj.prepare_packing(n=256, pressure=1e-3, seed=1) if comm.rank == 0 else None)

g = pj.complex_modulus(packing, np.geomspace(1e-6, 1e2, 9), damping=pj.ContactDamping(beta=1.0), comm=comm)

if comm.rank == 0:
    for omega, G, residual in zip(g.omega, g.values, g.residuals, strict=True):
        print(f"ω = {omega:8.1e}   G′ = {G.real:.6f}   G″ = {G.imag:.3e}   residual {residual:.0e}")
    print(f"G0 = {g.G0:.6f}, η0 = {g.eta0:.4f}; G∞ = {g.G_inf:.6f}, η∞ = {g.eta_inf:.6f}; stable: {g.stable}")

assert g.residuals.max() < 1e-10
assert abs(g.values[0].real / g.G0 - 1) < 1e-4

"""Stokes drag needs no matrix inversion: G* is a sum over the modes of K (docs: Theory).

mpirun -n 2 python -m mpi4py examples/02_stokes_drag_by_hand.py    (-m mpi4py: an error on one rank ends both)
"""

import numpy as np
from mpi4py import MPI

import petscjam as pj
from petscjam.reference import linear as reference

comm = MPI.COMM_WORLD
packing = comm.bcast(pj.prepare_packing(n=64, pressure=1e-2, seed=2) if comm.rank == 0 else None)
omega = np.geomspace(1e-3, 1e1, 5)

solved = pj.complex_modulus(packing, omega, damping=pj.StokesDrag(eta_fluid=1.0), comm=comm)

contacts = reference.contacts(packing.positions, packing.radii, packing.box.cell, packing.potential)
K = reference.hessian(contacts, packing.radii)
by_hand = np.array([reference.stokes_modal_sum(K, w, packing.box.area, eta_fluid=1.0) for w in omega])

if comm.rank == 0:
    for w, a, b in zip(omega, solved.values, by_hand, strict=True):
        print(f"ω = {w:7.1e}   solved {a:.10f}   by hand {b:.10f}")
assert np.allclose(solved.values, by_hand, rtol=1e-9)

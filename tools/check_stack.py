"""Print the versions of the stack; fails where PETSc is missing, has real scalars or lacks MUMPS."""

import sys

import h5py
import mpi4py
import numpy
import petsc4py
import slepc4py

from petscjam.parallel.petsc import petsc, slepc

PETSc, SLEPc = petsc(), slepc()
versions = [".".join(map(str, library.Sys.getVersion())) for library in (PETSc, SLEPc)]
print(f"Python {sys.version.split()[0]}, complex PETSc {versions[0]} with MUMPS, SLEPc {versions[1]}")
bindings = (petsc4py, slepc4py, mpi4py, h5py, numpy)
print(", ".join(f"{module.__name__} {module.__version__}" for module in bindings))

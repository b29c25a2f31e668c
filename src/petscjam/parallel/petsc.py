"""PETSc is started here, and an unsuitable PETSc is refused."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from petscjam.base.errors import InputError, MissingError, SolverError
from petscjam.base.interrupt import Interrupted, deferred
from petscjam.parallel.comm import Comm

ADVICE = (
    'with Python 3.12 or newer on Linux pip install "petscjam[solver]", on Debian install '
    "python3-petsc4py-complex and python3-slepc4py-complex, with conda install -c conda-forge "
    '"petsc4py=*=complex*" "slepc4py=*=complex*", elsewhere a PETSc configured with '
    "--with-scalar-type=complex --download-mumps (docs: Installing)"
)
OPENBLAS_KERNELS = {"SKYLAKEX": {"avx512f", "avx512dq", "avx512bw", "avx512vl"}, "HASWELL": {"avx2", "fma"}}
_options: list[str] = []
_world: list[Any] = []


def set_options(options: Sequence[str]) -> None:
    """Pass the options after ``--`` to PETSc, before the first solve; PETSc lists those that it did not use."""
    _options[:] = [*options, "-options_left"] if options else []


def start(comm: Comm) -> None:
    """Start PETSc and SLEPc on all ranks of ``comm`` together: ``-log_view`` then reports on all of them.

    Raises
    ------
    InputError
        As :func:`slepc`.
    """
    _world[:] = [comm]
    slepc()


@cache
def petsc() -> ModuleType:
    """Return ``petsc4py.PETSc``, started: rank by rank, unless :func:`start` was called before.

    So one rank may prepare a packing while the others wait for it. Every object has its own communicator.

    Raises
    ------
    MissingError
        An ImportError, if petsc4py is missing, has real scalars, or lacks MUMPS, with the way to install it.
    """
    _prepare_blas()
    try:
        import petsc4py
        from mpi4py import MPI

        # PETSc's signal handlers would end the job when a pipe closes, or at a signal that petscjam handles.
        petsc4py.init(["petscjam", "-no_signal_handler", *_options], comm=_world[0] if _world else MPI.COMM_SELF)
        from petsc4py import PETSc
    except ImportError as error:
        raise MissingError(f"petscjam needs petsc4py with complex scalars ({error}): {ADVICE}") from None
    check(PETSc)
    return PETSc


def _prepare_blas() -> None:
    """Set what OpenBLAS reads when PETSc loads it, unless the user has set it.

    One thread for each rank, and the kernel of OpenBLAS: for a processor newer than itself OpenBLAS uses the
    kernels of a Prescott of 2004, and MUMPS is more than twice as slow (docs/design/0004-openblas-kernel.md).
    """
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    with suppress(OSError):
        flags = re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
        for kernel, needs in OPENBLAS_KERNELS.items():
            if flags and needs <= set(flags[1].split()):
                os.environ.setdefault("OPENBLAS_CORETYPE", kernel)
                break


def check(PETSc: ModuleType) -> None:
    """Refuse a PETSc with real scalars or without MUMPS."""
    import numpy as np

    version = ".".join(map(str, PETSc.Sys.getVersion()))
    if not np.issubdtype(PETSc.ScalarType, np.complexfloating):
        raise MissingError(f"petscjam needs a complex PETSc; this one ({version}) has real scalars: {ADVICE}")
    if not PETSc.Sys.hasExternalPackage("mumps"):
        raise MissingError(f"petscjam needs MUMPS, and this PETSc ({version}) was built without it: {ADVICE}")


@cache
def slepc() -> ModuleType:
    """Return ``slepc4py.SLEPc``, started.

    Raises
    ------
    MissingError
        If SLEPc, or a suitable PETSc, is missing.
    """
    petsc()
    try:
        from slepc4py import SLEPc
    except ImportError as error:
        raise MissingError(f"petscjam needs slepc4py for eigenmodes ({error}): {ADVICE}") from None
    return SLEPc


@contextmanager
def destroying(*objects: Any) -> Iterator[None]:
    """Destroy PETSc objects at the end of the block; Ctrl-C is deferred. This is collective, and so are our own errors.

    Any other exception may be on this rank only: it is raised at once, and the objects exist until the end of the
    program.
    """
    with deferred():
        try:
            yield
        except (InputError, SolverError, Interrupted):
            _destroy(objects)
            raise
        _destroy(objects)


def _destroy(objects: Sequence[Any]) -> None:
    for item in objects:
        item.destroy()


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Name the block in PETSc's ``-log_view``."""
    log = petsc().Log.Stage(f"petscjam: {name}")
    log.push()
    try:
        yield
    finally:
        log.pop()

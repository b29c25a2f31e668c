"""What all tests share."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
MPI_ENV = Path(__file__).parents[1] / "tools" / "mpi-env.sh"

# derandomize: every rank must try the same examples. deadline: compiling and MPI take as long as they take.
settings.register_profile("petscjam", deadline=None, derandomize=True)
settings.load_profile("petscjam")


@pytest.fixture
def comm():
    """All ranks of this run, as many as ``@pytest.mark.parallel`` asks for."""
    from mpi4py import MPI

    return MPI.COMM_WORLD


@pytest.fixture
def environment():
    """Return the environment of Python's start, for subprocesses: ``subprocess.run(…, env=environment)``.

    MPI_Init adds variables to the one that a subprocess would inherit, and a second MPI stumbles over them.
    """
    return dict(os.environ)


@pytest.fixture
def mpirun(environment):
    """Run this Python under an mpirun of its own: ``mpirun(2, "-m", "petscjam", "--help")``."""
    launch = ["bash", "-c", '. "$0" && exec mpirun -n "$@"', str(MPI_ENV)]

    def run(ranks, *arguments, timeout=120, **options):
        command = [*launch, str(ranks), sys.executable, *map(str, arguments)]
        options = {"capture_output": True, "text": True, "env": environment, **options}
        return subprocess.run(command, timeout=timeout, **options)

    return run

"""What all tests share."""

import os
import subprocess
import sys

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")

# derandomize: every rank must try the same examples. deadline: compiling and MPI take as long as they take.
settings.register_profile("petscjam", deadline=None, derandomize=True)
settings.load_profile("petscjam")


@pytest.fixture
def comm():
    """All ranks of this run, as many as ``@pytest.mark.parallel`` asks for."""
    from mpi4py import MPI

    return MPI.COMM_WORLD


@pytest.fixture
def mpirun():
    """Run this Python under an mpirun of its own: ``mpirun(2, "-m", "petscjam", "--help")``.

    The environment is that of Python's start: MPI_Init adds variables that make a second mpirun fail, and a
    subprocess without ``env`` would inherit them.
    """
    environment = dict(os.environ)

    def run(ranks, *arguments, timeout=120, **options):
        command = ["mpirun", "-n", str(ranks), sys.executable, *map(str, arguments)]
        options = {"capture_output": True, "text": True, "env": environment, **options}
        return subprocess.run(command, timeout=timeout, **options)

    return run

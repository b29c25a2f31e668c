"""A PETSc that cannot serve is refused by one sentence that says what is missing and how to get it."""

import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import petscjam as pj
from petscjam.parallel.petsc import OPENBLAS_KERNELS, check


def petsc_with(scalar, packages):
    system = SimpleNamespace(getVersion=lambda: (3, 18, 5), hasExternalPackage=packages.__contains__)
    return SimpleNamespace(ScalarType=scalar, Sys=system)


@pytest.mark.parametrize(
    ("scalar", "packages", "missing"), [(np.float64, ["mumps"], "real scalars"), (np.complex128, ["superlu"], "MUMPS")]
)
def test_a_petsc_that_cannot_serve(scalar, packages, missing):
    with pytest.raises(pj.InputError, match=missing) as error:
        check(petsc_with(scalar, packages))
    assert isinstance(error.value, ImportError)
    for way in ('pip install "petscjam[solver]"', "python3-petsc4py-complex", "conda install -c conda-forge"):
        assert way in str(error.value)
    assert "\n" not in str(error.value)


def test_a_complex_petsc_with_mumps_serves():
    check(petsc_with(np.complex128, ["mumps"]))


@pytest.mark.parametrize(("library", "loader"), [("petsc4py", "petsc"), ("slepc4py", "slepc")])
def test_a_library_that_is_missing(environment, library, loader):
    """Hidden from the import system, in a process of its own."""
    code = (
        f"import sys; sys.modules[{library!r}] = None\n"
        f"from petscjam.parallel.petsc import {loader}\n"
        f"from petscjam import InputError\n"
        f"try: {loader}()\n"
        f"except InputError as error: print(error)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60)
    assert f"petscjam needs {library}" in run.stdout
    assert "python3-slepc4py-complex" in run.stdout
    assert run.stdout.count("\n") == 1


def test_the_user_chooses_the_blas(environment):
    """What the user has set stays."""
    code = (
        "import os; from petscjam.parallel.petsc import petsc; petsc()\n"
        "print(os.environ['OMP_NUM_THREADS'], os.environ.get('OPENBLAS_CORETYPE'))"
    )
    chosen = {**environment, "OMP_NUM_THREADS": "3", "OPENBLAS_CORETYPE": "NEHALEM"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=chosen, timeout=60)
    assert run.stdout.split() == ["3", "NEHALEM"]


@pytest.mark.skipif(not os.path.exists("/proc/cpuinfo"), reason="needs Linux")
def test_the_kernel_suits_the_processor(environment):
    """The kernel that is named has instructions that this processor has."""
    code = (
        "import os; from petscjam.parallel.petsc import petsc; petsc()\n"
        "print(os.environ.get('OPENBLAS_CORETYPE', 'none'))"
    )
    bare = {key: value for key, value in environment.items() if key != "OPENBLAS_CORETYPE"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=bare, timeout=60)
    named = run.stdout.strip()
    with open("/proc/cpuinfo") as cpu:
        flags = cpu.read()
    assert all(flag in flags for flag in OPENBLAS_KERNELS.get(named, ()))
    assert named != "none" or "avx2" not in flags


# --- memory


@pytest.mark.parallel(nprocs=[1, 2])
def test_a_factor_that_does_not_fit_is_refused_before_any_work(comm, monkeypatch):
    from petscjam.parallel import memory

    monkeypatch.setattr(memory, "available_memory", lambda: 100.0)
    with pytest.raises(pj.InputError, match="300000 unknowns needs about 655 MB, 555 MB more"):
        memory.check_memory(comm, 300_000)
    assert "655 MB" in memory.check_memory(comm, 300_000, out_of_core=True)
    assert "needs about 1 MB" in memory.check_memory(comm, 1000)


def test_the_estimate_of_a_factor_is_what_mumps_takes():
    from petscjam.parallel.memory import factor_memory

    packing = pj.prepare_packing(4096, 1e-1, 1)
    s = pj.spectrum(packing, (1e-2, 1e-2), displacements=False)
    assert 0.4 < s.performance["mumps_MB"] / factor_memory(s.performance["unknowns"]) < 2.5


@pytest.mark.slow
def test_a_compressed_factor_gives_the_same_modulus():
    """65 536 disks, tiles of 1024: with fewer MUMPS compresses nothing."""
    tile = pj.prepare_packing(1024, 1e-1, 1)
    shifts = np.array([[i, j] for i in range(8) for j in range(8)]) @ tile.box.cell
    positions = (tile.positions + shifts[:, None]).reshape(-1, 2)
    tiles = pj.Packing(positions, np.tile(tile.radii, 64), pj.Box(8 * tile.box.cell))
    exact, compressed = (
        pj.spectrum(p, (1e-2, 1e-2), prestress=False, displacements=False, **options)
        for p, options in ((tile, {}), (tiles, {"block_low_rank": 1e-8}))
    )
    assert compressed(1e-2) == pytest.approx(exact(1e-2), rel=1e-9)
    assert compressed.performance["residual"] < 1e-10

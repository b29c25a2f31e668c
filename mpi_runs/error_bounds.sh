#!/usr/bin/env bash
# Spectra of a library of 52 packings: factorisations, error bounds, true errors. Called by make bench-bounds.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
python=${PYTHON:-.venv/bin/python}
library=demo/error_bounds
mkdir -p demo

for what in "1024 1:8" "4096 1:5"; do
    set -- $what
    mpirun -n 2 $python -m petscjam prepare --particles "$1" --pressure 1e-2:1e-5:4 --seeds "$2" --resume -o $library
done
mpirun -n 2 $python benchmarks/error_bounds.py $library
$python benchmarks/rational.py

#!/usr/bin/env bash
# The spectrum and direct solves compared with bare MUMPS and with SciPy. Called by make bench.
# DISKS=4096 FREQUENCIES=21 make bench for a smaller one; the default takes about five minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
python=${PYTHON:-.venv/bin/python}
disks=${DISKS:-32768}
mkdir -p demo

$python -m petscjam prepare --particles "$disks" --pressure 1e-2 --seed 1 --resume -o "demo/bench-$disks.h5"
$python benchmarks/spectrum.py "demo/bench-$disks.h5" --direct 60 --splu
for ranks in 1 2; do
    mpirun -n $ranks $python benchmarks/direct_sweep.py "demo/bench-$disks.h5" "${FREQUENCIES:-61}"
done

#!/usr/bin/env bash
# A sweep of G*(ω) over an ensemble. Edit the lines below, then: bash mpi_runs/sweep.sh
# Started again, it goes on where it stopped.
set -euo pipefail
ranks=2
particles=1024
pressures="1e-2 1e-3 1e-4"
seeds=1:10
omega=1e-8:1e2:61
law="--damping contact --beta 1" # or: --damping stokes --eta-fluid 1
folder=runs
petscjam=.venv/bin/petscjam

cd "$(dirname "$0")/.."
. tools/mpi-env.sh
for pressure in $pressures; do
    packings=$folder/packings-N$particles-p$pressure
    mpirun -n $ranks $petscjam prepare --particles $particles --pressure $pressure --seeds $seeds \
        --resume -o $packings
    mpirun -n $ranks $petscjam moduli $packings/*.h5 --omega $omega $law \
        --resume -o $folder/modulus-N$particles-p$pressure.h5
done

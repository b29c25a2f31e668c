#!/usr/bin/env bash
# G*(ω) of an ensemble at many frequencies. Edit mpi_runs/sweep.conf, then: bash mpi_runs/sweep.sh
# A second start continues where the first stopped. LAUNCH and PYTHON may be set in the environment (sweep.slurm does).
set -euo pipefail
cd "$(dirname "$0")/.."
. mpi_runs/sweep.conf
. tools/mpi-env.sh
launch=${LAUNCH:-mpirun -n 2}

mkdir -p "$folder"
for pressure in $pressures; do
    packings=$folder/packings-N$particles-p$pressure
    $launch petscjam prepare --particles $particles --pressure $pressure --seeds $seeds --resume -o $packings
    $launch petscjam moduli $packings --omega $omega $law --resume -o $folder/modulus-N$particles-p$pressure.h5
done

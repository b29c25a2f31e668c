#!/usr/bin/env bash
# Time five frequencies of G*(ω) on 1 and 2 ranks. Called by make bench; DISKS=32768 make bench for the large one.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
petscjam=$(dirname "$(command -v "${PYTHON:-.venv/bin/python}")")/petscjam
disks=${DISKS:-4096}
mkdir -p demo

$petscjam prepare --particles "$disks" --pressure 1e-3 --seed 1 --resume -o "demo/bench-$disks.h5"
for ranks in 1 2; do
    start=$(date +%s.%N)
    mpirun -n $ranks $petscjam moduli "demo/bench-$disks.h5" --omega 1e-4:1:5 --damping contact --beta 1 --direct \
        --overwrite -o "demo/bench-$disks-modulus.h5" -- -log_view ":demo/bench-$disks-$ranks.log"
    awk -v s="$start" -v e="$(date +%s.%N)" -v n="$disks" -v r="$ranks" \
        'BEGIN { printf "%d disks, 5 frequencies, %d rank(s): %.1f s in all\n", n, r, e - s }'
done
echo "PETSc's own account: demo/bench-$disks-1.log, demo/bench-$disks-2.log"

#!/usr/bin/env bash
# All figures of Baumgarten & Tighe 2017, and two more, in runs/PRESET: bash mpi_runs/figures.sh [small|medium|paper]
# A second start continues where the first stopped. Options of petscjam figure may follow, as --existing. LAUNCH and
# PYTHON may be set in the environment. The parameters are in mpi_runs/bt1.toml … bt8.toml, modes.toml, drag.toml.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
launch=${LAUNCH:-mpirun -n 2}
preset=${1:-small}

for name in bt1 bt2 bt3 bt4 bt5 bt6 bt7 bt8 modes drag; do
    $launch petscjam figure $name --preset "$preset" --resume "${@:2}"
done

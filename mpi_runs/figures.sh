#!/usr/bin/env bash
# Figures of both papers, in runs/PRESET: bash mpi_runs/figures.sh [small|medium|paper] [NAME …] [OPTION …]
# Without names: those of Baumgarten & Tighe 2017, and three more. vot stands for all of Vagberg, Olsson & Teitel 2017, whose
# three sets of runs take up to three hours each (medium, two cores). A second start continues where the first stopped.
# Options of petscjam figure may follow, as --existing or --engine cuda. LAUNCH and PYTHON may be set in the environment.
# The parameters are in mpi_runs/*.toml.
set -euo pipefail
cd "$(dirname "$0")/.."
. tools/mpi-env.sh
launch=${LAUNCH:-mpirun -n 2}
preset=${1:-small}
shift $(($# > 0))
names=()
while [ $# -gt 0 ] && [[ $1 != -* ]]; do
    names+=("$1")
    shift
done
[ ${#names[@]} -gt 0 ] || names=(bt1 bt2 bt3 bt4 bt5 bt6 bt7 bt8 modes drag nonlinear-drag softening)
[ "${names[*]}" != vot ] || names=(vot{1..6} vot{8..36})

for name in "${names[@]}"; do
    $launch petscjam figure "$name" --preset "$preset" --resume -o "runs/$preset" "$@"
done

#!/usr/bin/env bash
# Run the tests rank count by rank count: tools/test.sh PYTHON 'not slow'
# COVERAGE=1 measures which lines they run.
# mpi-pytest marks every test parallel[R]; one without @pytest.mark.parallel is parallel[1].
set -euo pipefail
cd "$(dirname "$0")/.."
export PYTHON=$1
which=$2
. tools/mpi-env.sh

failed=()
for ranks in ${RANKS:-1 2 3}; do
    tests=("$PYTHON" ${COVERAGE:+-m coverage run} -m pytest -m "parallel[$ranks] and $which")
    echo "== tests on $ranks rank(s), $which"
    status=0
    launch=()
    [ "$ranks" = 1 ] || launch=(mpirun -n "$ranks")
    # A rank of MPICH that waits gives way to the others; where each has a core that costs time.
    [ "$ranks" -le "$(nproc)" ] || export MPIR_CVAR_ENABLE_HEAVY_YIELD=1
    timeout -k 30 "${LIMIT:-1800}" "${launch[@]}" "${tests[@]}" || status=$?
    [ $status = 0 ] || [ $status = 5 ] || failed+=("$ranks") # 5: no test for so many ranks
done
[ ${#failed[@]} = 0 ] || { echo "Tests failed on: ${failed[*]} rank(s)" >&2; exit 1; }

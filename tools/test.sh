#!/usr/bin/env bash
# Run the tests rank count by rank count: tools/test.sh PYTHON 'not slow'
# mpi-pytest marks every test parallel[R]; one without @pytest.mark.parallel is parallel[1].
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1
which=$2
. tools/mpi-env.sh

failed=()
for ranks in ${RANKS:-1 2 3}; do
    tests=("$python" -m pytest -m "parallel[$ranks] and $which")
    echo "== tests on $ranks rank(s), $which"
    status=0
    if [ "$ranks" = 1 ]; then
        timeout -k 30 "${LIMIT:-1800}" "${tests[@]}" || status=$?
    else # the other ranks report failures only
        timeout -k 30 "${LIMIT:-1800}" mpirun -n 1 "${tests[@]}" : \
            -n $((ranks - 1)) "${tests[@]}" -qq --no-header --disable-warnings || status=$?
    fi
    [ $status = 0 ] || [ $status = 5 ] || failed+=("$ranks") # 5: no test for so many ranks
done
[ ${#failed[@]} = 0 ] || { echo "Tests failed on: ${failed[*]} rank(s)" >&2; exit 1; }

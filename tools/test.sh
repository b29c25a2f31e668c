#!/usr/bin/env bash
# Run the tests rank count by rank count: tools/test.sh PYTHON 'not slow'
# COVERAGE=1 measures which lines they run.
# mpi-pytest marks every test parallel[R]; one without @pytest.mark.parallel is parallel[1].
set -euo pipefail
cd "$(dirname "$0")/.."
export PYTHON=$1
which=$2
. tools/mpi-env.sh
cores=$(env -u OMP_NUM_THREADS nproc) # which counts no more than these threads
share=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$share" "$share.log"' EXIT

failed=()
check() { # 5: no test for so many ranks
    [ "$1" = 0 ] || [ "$1" = 5 ] || failed+=("$ranks")
}

for ranks in ${RANKS:-1 2 3}; do
    launch=()
    [ "$ranks" = 1 ] || launch=(mpirun -n "$ranks")
    tests=(timeout -k 30 "${LIMIT:-1800}" "${launch[@]}" "$PYTHON" ${COVERAGE:+-m coverage run}
        -m pytest -m "parallel[$ranks] and $which")
    echo "== tests on $ranks rank(s), $which"
    # A rank of MPICH that waits gives way to the others; where each has a core that costs time.
    # Serial tests start two or three ranks as well.
    export MPIR_CVAR_ENABLE_HEAVY_YIELD=$((ranks == 1 || ranks > cores))

    backwards=
    if [ "$ranks" = 1 ] && [ "$cores" -gt 1 ]; then
        # Two processes share the serial tests, one from the front and one from the back of the list, until they meet.
        # In the background a shell ignores SIGINT, which some tests need.
        tests+=("--share=$share")
        env --default-signal=INT "${tests[@]}" --backwards >"$share.log" 2>&1 &
        backwards=$!
    fi
    status=0
    "${tests[@]}" || status=$?
    check $status
    if [ "$backwards" ]; then
        status=0
        wait $backwards || status=$?
        cat "$share.log"
        check $status
    fi
done
[ ${#failed[@]} = 0 ] || { echo "Tests failed on: ${failed[*]} rank(s)" >&2; exit 1; }

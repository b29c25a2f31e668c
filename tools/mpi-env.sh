# Sourced before mpirun and petscjam: both are those of $PYTHON, or of .venv/bin/python.
# The wheel of MPICH, and conda, have mpirun beside Python; with Debian's packages it is on the path.
beside=$(command -v "${PYTHON:-.venv/bin/python}") && PATH=$(cd "$(dirname "$beside")" && pwd):$PATH
unset beside
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1} # one thread a rank
# Open MPI 4 reads OMPI_MCA_*, Open MPI 5 PRTE_MCA_*; others ignore both.
# A rank that waits gives way to other work; it costs nothing where there is none.
export OMPI_MCA_mpi_yield_when_idle=1
# More ranks than cores are fine, and two runs side by side must not be bound to the same core.
export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
export OMPI_MCA_hwloc_base_binding_policy=none PRTE_MCA_hwloc_default_binding_policy=none
# A serial run of Open MPI 4 starts a daemon; that of a killed run can go on without end, on a full core.
export OMPI_MCA_ess_singleton_isolated=1
if [ "$(id -u)" = 0 ]; then # Open MPI refuses to run as root unless told twice
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi

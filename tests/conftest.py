"""What all tests share."""

import hashlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("NUMBA_ENABLE_CUDASIM", "1")  # kernels for GPUs run as Python threads; 0: on a GPU
START = dict(os.environ)
sys.setswitchinterval(1e-5)  # these threads take turns more often
MPI_ENV = Path(__file__).parents[1] / "tools" / "mpi-env.sh"

# derandomize: every rank must try the same examples. deadline: compiling and MPI take as long as they take.
settings.register_profile("petscjam", deadline=None, derandomize=True)
settings.load_profile("petscjam")


def is_quiet():
    """Whether this is one of the ranks that report failures only."""
    from mpi4py import MPI

    return MPI.COMM_WORLD.rank > 0


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    if is_quiet():
        config.option.verbose = -2
        config.option.no_header = config.option.disable_warnings = True


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report):
    return (report.outcome, "", "") if is_quiet() and not report.failed else None


def pytest_addoption(parser):
    parser.addoption(
        "--share", type=Path, metavar="FOLDER", help="leave out the tests begun by another run with FOLDER"
    )
    parser.addoption("--backwards", action="store_true", help="run the last test first")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    if config.option.backwards:
        items.reverse()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item):
    """Leave a test out if another run has begun it: the first to create its file in the folder runs it."""
    if item.config.option.share:
        try:
            (item.config.option.share / hashlib.sha256(item.nodeid.encode()).hexdigest()).touch(exist_ok=False)
        except FileExistsError:
            return True
    return None


NUMPYS = re.compile(rb"np\.(float|complex|u?int|str_|True_|False_)")


@pytest.fixture(autouse=True, scope="session")
def no_text_in_numpys_words(tmp_path_factory):
    """See that no message and no file has np.float64(1.4) for 1.4: repr of NumPy 2, also inside of tuples."""
    from petscjam.base.errors import InputError, SolverError

    def checked(error, message):
        Exception.__init__(error, message)
        assert not NUMPYS.search(message.encode(errors="replace")), message

    InputError.__init__ = SolverError.__init__ = checked
    yield
    for path in tmp_path_factory.getbasetemp().rglob("*"):
        found = path.is_file() and NUMPYS.search(path.read_bytes())
        assert not found, f"{path}: {found[0]}"


@pytest.fixture
def comm():
    """All ranks of this run, as many as ``@pytest.mark.parallel`` asks for."""
    from mpi4py import MPI

    return MPI.COMM_WORLD


@pytest.fixture(params=["cpu", "cuda"])
def engine(request):
    """Name of an engine of sheared disks: tests are the same for each (:func:`helpers.any_engine` for more cases)."""
    return request.param


@pytest.fixture
def kind(engine):
    """Class of this engine."""
    from petscjam.md.runs import engine_of

    return engine_of(engine)


@pytest.fixture(scope="session")
def three_packings(tmp_path_factory):
    """Return a folder of three packings of 64 disks, stable against shear, made by rank 0: p1.h5 to p3.h5."""
    from helpers import jammed
    from mpi4py import MPI

    from petscjam.parallel.comm import on_root
    from petscjam.parallel.petsc import start

    def prepare():
        folder = tmp_path_factory.mktemp("packings")
        for seed in (1, 2, 3):
            jammed(seed=seed, shear_stabilised=True).write(folder / f"p{seed}.h5")
        return folder

    start(MPI.COMM_WORLD)  # as the command does before any rank is on its own
    return on_root(MPI.COMM_WORLD, prepare)


@pytest.fixture
def titles(monkeypatch):
    """Every text in the figures that a test saves, which are drawn coarsely."""
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    found, savefig = [], Figure.savefig

    def keep(figure, *arguments, **options):
        found.extend(text.get_text() for text in figure.findobj(Text) if text.get_text())
        savefig(figure, *arguments, **{**options, "dpi": 20})

    monkeypatch.setattr(Figure, "savefig", keep)
    return found


@pytest.fixture
def environment():
    """Return the environment of Python's start, for subprocesses: ``subprocess.run(…, env=environment)``.

    MPI_Init adds variables to the one that a subprocess would inherit, and a second MPI stumbles over them.
    PETSc's start adds some of OpenBLAS, and a NumPy that sees them from the first rounds otherwise.
    """
    return dict(START)


@pytest.fixture
def launch():
    """Return the words before a command on so many ranks: ``[*launch(2), sys.executable, …]``."""
    script = 'export PYTHON="$1" && . "$0" && shift && exec mpirun -n "$@"'
    return lambda ranks: ["bash", "-c", script, str(MPI_ENV), sys.executable, str(ranks)]


@pytest.fixture
def mpirun(environment, launch):
    """Run this Python under an mpirun of its own: ``mpirun(2, "-m", "petscjam", "--help")``."""

    def run(ranks, *arguments, timeout=120, **options):
        command = [*launch(ranks), sys.executable, *map(str, arguments)]
        options = {"capture_output": True, "text": True, "env": environment, **options}
        return subprocess.run(command, timeout=timeout, **options)

    return run

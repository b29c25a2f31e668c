"""The process that runs a command: its streams, names, launcher, compiled kernels, limits."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers import COMMAND, SIXTEEN, sixteen

import petscjam as pj
from petscjam.cli import main
from petscjam.cli.streams import Stream
from petscjam.parallel import solver
from petscjam.parallel.solver import DirectSolver


@pytest.fixture
def packing(tmp_path):
    path = tmp_path / "sixteen.h5"
    sixteen().write(path)
    return path


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_computation_goes_on_where_nobody_reads(packing, tmp_path, environment, stream):
    reader, writer = os.pipe()
    os.close(reader)
    given = [*COMMAND, "moduli", packing, "--omega", "1,2", "-o", tmp_path / "g.h5"]
    other = {"stdout": "stderr", "stderr": "stdout"}[stream]
    done = subprocess.run(given, env=environment, **{stream: writer, other: subprocess.PIPE}, timeout=120)
    os.close(writer)
    assert done.returncode == 0
    assert b"Traceback" not in getattr(done, other)
    assert pj.read_modulus(tmp_path / "g.h5").omega.tolist() == [1.0, 2.0]


def test_what_could_not_be_printed_is_said(packing, tmp_path, environment):
    given = [*COMMAND, "moduli", packing, "--omega", "1,2", "-o", tmp_path / "g.h5"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(given, env=environment, stdout=full, stderr=subprocess.PIPE, text=True, timeout=120)
    assert done.returncode == 1
    assert done.stderr.endswith("petscjam: standard output: No space left on device\n")
    assert "Traceback" not in done.stderr
    assert pj.read_modulus(tmp_path / "g.h5").omega.tolist() == [1.0, 2.0]


def test_a_command_without_streams(packing, environment):
    done = subprocess.run(
        ["bash", "-c", '"$@" >&- 2>&-', "bash", *COMMAND, "info", packing], env=environment, timeout=120
    )
    assert done.returncode == 0


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_characters_that_the_terminal_lacks_are_replaced(environment, encoding):
    done = subprocess.run(
        [*COMMAND, "shear", "--help"],
        capture_output=True,
        timeout=120,
        env={**environment, "PYTHONIOENCODING": encoding},
    )
    assert done.returncode == 0
    assert done.stderr == b""
    assert b"--particles N,?" in done.stdout


def test_a_stream_goes_on_after_an_error():
    with open("/dev/full", "w") as full:
        stream = Stream(full)
        stream.write("lost")
        assert stream.error is None  # Python keeps it for now
        stream.flush()
        assert stream.error.strerror == "No space left on device"
        stream.write("lost, too")
        stream.flush()


def test_names_that_are_no_text(tmp_path, packing, capsys):
    odd = tmp_path / os.fsdecode(b"sixteen\xff.h5")
    packing.rename(odd)
    out = tmp_path / os.fsdecode(b"\xfe.h5")
    assert main(["moduli", str(odd), "--omega", "1,2", "-o", str(out)]) == 0
    assert [name[:8] for name in pj.read_moduli(out)] == ["sixteen?"]
    for verb in ("info", "plot", "export"):
        assert main([verb, str(out)]) == 0
    assert main(["info", str(tmp_path / os.fsdecode(b"none\xff.h5"))]) == 2
    assert capsys.readouterr().err.endswith(".h5: No such file or directory\n")


def test_a_start_whose_name_is_no_text(tmp_path):
    odd = tmp_path / os.fsdecode(b"start\xff.h5")
    short = {"n": 16, "rate": 1e-2, "strain": 0.02, "seed": 1}
    pj.md.shear(**short, output=odd)
    pj.md.shear(rate=1e-2, strain=0.02, start=odd, output=tmp_path / "run.h5")
    assert pj.md.read(tmp_path / "run.h5").settings.start.startswith("start?.h5: ")


def test_a_library_with_a_name_that_is_no_text(tmp_path):
    pj.prepare_library(tmp_path, [16], [1e-2])
    odd = os.fsdecode(b"\xff.h5")
    (tmp_path / "N16_p0.01_s0001.h5").rename(tmp_path / odd)
    pj.prepare_library(tmp_path, [16], [1e-2], resume=True)
    library = pj.prepare_library(tmp_path, [16], [1e-2], resume=True)
    assert {row["file"] for row in library.rows} == {"N16_p0.01_s0001.h5", odd}


@pytest.mark.parametrize(
    "variable", ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS"]
)
def test_the_launcher_of_another_mpi_is_refused(packing, tmp_path, monkeypatch, capsys, variable):
    """Each of its ranks would be alone, and all of them write one file."""
    from mpi4py import MPI

    monkeypatch.setenv(variable, "4")
    assert main(["moduli", str(packing), "--omega", "1,2", "-o", str(tmp_path / "g.h5")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("petscjam: 4 ranks were started, but each is alone: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "g.h5").exists()
    with pytest.raises(pj.InputError, match="4 ranks were started"):
        pj.complex_modulus(pj.Packing.read(packing), [1.0], comm=MPI.COMM_WORLD)
    assert pj.complex_modulus(pj.Packing.read(packing), [1.0], comm=MPI.COMM_SELF).G0 > 0


@pytest.mark.parametrize(
    "variables", [{"SLURM_NTASKS": "4"}, {"PMI_SIZE": "1", "SLURM_STEP_NUM_TASKS": "4"}, {"PMI_SIZE": "many"}]
)
def test_one_process_in_a_job_of_several_is_no_mistake(monkeypatch, variables):
    """A batch script is alone, and the innermost launcher counts."""
    from petscjam.parallel.comm import world

    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert world().size == 1


LOOP = """
from petscjam.base.compiled import njit

@njit(cache=True)
def double(x):
    return 2 * x
"""


def loop(folder):
    """Import a compiled function anew, as another process would."""
    (folder / "loops.py").write_text(LOOP)
    spec = importlib.util.spec_from_file_location("loops", folder / "loops.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.double


def test_a_loop_is_compiled_once(tmp_path):
    assert loop(tmp_path)(21) == 42
    again = loop(tmp_path)
    assert again(21) == 42
    assert sum(again.stats.cache_hits.values()) == 1


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [b"", b"\x80\x04rubbish", None])
def test_a_damaged_cache_is_replaced(tmp_path, ending, damage):
    loop(tmp_path)(21)
    (file,) = (tmp_path / "__pycache__").glob(f"*.{ending}")
    file.write_bytes(file.read_bytes()[:-50] if damage is None else damage)
    with pytest.warns(RuntimeWarning, match="numba's cache cannot be used"):
        assert loop(tmp_path)(21) == 42
    again = loop(tmp_path)
    assert again(21) == 42
    assert sum(again.stats.cache_hits.values()) == 1


def test_a_full_disk_costs_the_cache_only(tmp_path, monkeypatch):
    from numba.core.caching import IndexDataCacheFile

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(IndexDataCacheFile, "_save_data", full)
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        assert loop(tmp_path)(21) == 42


def test_no_folder_for_the_cache(tmp_path, monkeypatch):
    from numba.core.caching import CacheImpl

    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    with pytest.warns(RuntimeWarning, match="no locator available"):
        assert loop(tmp_path)(21) == 42


@pytest.mark.parametrize(
    "variable", [("NUMBA_NUM_THREADS", "-1"), ("NUMBA_THREADING_LAYER", "tbb"), ("NUMBA_THREADING_LAYER", "x")]
)
def test_a_numba_that_cannot_start_is_a_line(tmp_path, environment, variable):
    if variable[1] == "tbb" and importlib.util.find_spec("tbb"):
        pytest.skip("this machine has TBB")
    given = [*COMMAND, "prepare", "--particles", "16", "-o", tmp_path / "p.h5"]
    done = subprocess.run(
        given, env={**environment, variable[0]: variable[1]}, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 2
    assert done.stderr.startswith("petscjam: numba cannot start: ")
    assert done.stderr.count("\n") == 1


FORKED = """
import os, sys
import petscjam as pj
pj.prepare_packing(16, 1e-2)
if os.fork() == 0:
    pj.prepare_packing(16, 1e-2)
    try:
        pj.md.shear(n=16, strain=0.1, rate=1e-2, threads=2)
    except pj.InputError as error:
        print(error, flush=True)
        os._exit(3)
    os._exit(0)
print(os.waitstatus_to_exitcode(os.wait()[1]))
"""


def test_threads_in_a_forked_child_are_refused(environment):
    """They hang or abort (OpenMP) there; without threads it works."""
    done = subprocess.run(
        [sys.executable, "-c", FORKED],
        env={**environment, "NUMBA_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("threads = 2: this process was forked")
    assert done.stdout.endswith("3\n")


def written(root, texts):
    for name, text in texts.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


UNIFIED = {
    "proc/self/cgroup": "0::/job/step\n",
    "sys/fs/cgroup/job/memory.max": f"{400 * 2**20}\n",
    "sys/fs/cgroup/job/memory.current": f"{150 * 2**20}\n",
    "sys/fs/cgroup/job/memory.stat": f"anon 1\ninactive_file {50 * 2**20}\n",
    "sys/fs/cgroup/job/step/memory.max": "max\n",
    "sys/fs/cgroup/job/step/memory.current": "1\n",
    "sys/fs/cgroup/job/cpu.max": "max 100000\n",
    "sys/fs/cgroup/job/step/cpu.max": "250000 100000\n",
}
OLDER = {
    "proc/self/cgroup": "4:memory:/docker/1\n1:cpu,cpuacct:/docker/1\n0::/\n",
    "sys/fs/cgroup/memory/memory.limit_in_bytes": f"{400 * 2**20}\n",  # in a container its own is the root
    "sys/fs/cgroup/memory/memory.usage_in_bytes": f"{150 * 2**20}\n",
    "sys/fs/cgroup/memory/memory.stat": f"cache 1\ninactive_file 7\ntotal_inactive_file {50 * 2**20}\n",
    "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "250000\n",
    "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
}


@pytest.mark.parametrize("files", [UNIFIED, OLDER], ids=["version 2", "version 1"])
def test_the_limits_of_a_container_are_seen(tmp_path, monkeypatch, files):
    from mpi4py import MPI

    from petscjam.parallel import container
    from petscjam.parallel.memory import available_memory
    from petscjam.parallel.teams import cores_each

    monkeypatch.setattr(container, "ROOT", tmp_path)
    assert container.memory_left() == container.cores() == float("inf")
    written(tmp_path, files)
    assert container.memory_left() == 300
    assert available_memory() <= 300
    assert container.cores() == 2.5
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)))
    assert cores_each(MPI.COMM_SELF) == 2


def test_no_limit_is_no_limit(tmp_path, monkeypatch):
    from petscjam.parallel import container

    monkeypatch.setattr(container, "ROOT", tmp_path)
    unlimited = {
        "sys/fs/cgroup/memory/memory.limit_in_bytes": str(2**63 - 4096),
        "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "-1\n",
    }
    written(tmp_path, OLDER | unlimited)
    assert container.memory_left() > 1e12
    assert container.cores() == float("inf")


@pytest.mark.parallel([1, 2])
def test_a_factor_out_of_core_leaves_nothing_behind(comm, tmp_path, monkeypatch):
    """Nor after an interrupt, and the folder is that which was asked for."""
    folder = Path(comm.bcast(str(tmp_path)))
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(folder))
    found = sixteen()
    seen, factor = [], DirectSolver.factor

    def factored(self, A):
        factor(self, A)
        comm.barrier()
        seen.append([file.name for part in folder.glob("petscjam-*") for file in part.iterdir()])
        if stopping:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(DirectSolver, "factor", factored)
    for stopping in (False, True):
        with pytest.raises(KeyboardInterrupt) if stopping else nullcontext():
            pj.spectrum(found, (1e-2, 1.0), out_of_core=True, comm=comm)
        comm.barrier()
        assert seen[0]
        assert list(folder.iterdir()) == []
        assert os.environ["MUMPS_OOC_TMPDIR"] == str(folder)


def test_a_folder_out_of_core_that_cannot_serve_is_refused(packing, tmp_path, monkeypatch, capsys):
    wanted = ["moduli", str(packing), "--omega", "1,2", "--out-of-core", "-o", str(tmp_path / "g.h5")]
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(tmp_path / "none"))
    assert main(wanted) == 2
    assert f"out of core: there is no folder {tmp_path / 'none'}" in capsys.readouterr().err
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(scratch))
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda path, mode: path != scratch)
        assert main(wanted) == 2
    assert "is not writable; MUMPS_OOC_TMPDIR names a folder" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
        assert main(wanted) == 2
    assert "has 0 MB free; MUMPS_OOC_TMPDIR names a folder" in capsys.readouterr().err
    assert main(wanted) == 0


def test_a_disk_that_fills_up_is_said_in_words(tmp_path, monkeypatch):
    """The code is MUMPS's: where the disk itself is full, its writing thread may wait for ever."""
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(tmp_path))
    assert solver._advice(-90, None) == (
        f"the factor could not be kept in {tmp_path} (INFOG(1) = -90); is the disk full?"
    )


def test_an_error_on_one_rank_ends_a_script(tmp_path, mpirun):
    """As the how-to pages say; without ``-m mpi4py`` rank 0 waits for ever."""
    script = tmp_path / "script.py"
    script.write_text(
        "from mpi4py import MPI; import petscjam as pj\n"
        "comm = MPI.COMM_WORLD\n"
        f"packing = pj.import_packing({str(SIXTEEN)!r} if comm.rank == 0 else 'nofile.h5')\n"
        "pj.spectrum(packing, (1e-2, 1.0), comm=comm)\n"
    )
    run = mpirun(2, "-m", "mpi4py", script, timeout=60)
    assert run.returncode != 0
    assert "nofile.h5: No such file or directory" in run.stderr


def test_a_run_that_goes_on_elsewhere_says_that_bits_may_differ(tmp_path, monkeypatch, capsys, recwarn):
    from petscjam.md import runs

    out = tmp_path / "run.h5"
    short = {"n": 16, "rate": 1e-2, "seed": 1, "row_time": 5.0, "output": out, "resume": True}
    pj.md.shear(**short, strain=0.1)
    pj.md.shear(**short, strain=0.2)
    assert [str(w.message) for w in recwarn if w.category is UserWarning] == []
    here = runs.build()
    elsewhere = {"numba": "0.1", "processor": "pentium"}
    with monkeypatch.context() as patch:
        patch.setattr(runs, "build", lambda: elsewhere)
        with pytest.warns(UserWarning, match=f"made with numba {here['numba']}, now 0.1; processor .*bits may differ"):
            pj.md.shear(**short, strain=0.3)
    assert elsewhere.items() <= pj.md.read(out).settings.attributes.items()
    given = ["--particles", "16", "--rate", "1e-2", "--strain", "0.4", "--row-time", "5", "--resume"]
    with pytest.warns(UserWarning, match=f"processor pentium, now {here['processor']}: the last bits"):
        assert main(["shear", *given, "-o", str(out)]) == 0

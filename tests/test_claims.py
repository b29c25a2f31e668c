"""Two runs never write to one output: the second is refused in a line, before any work."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import SIXTEEN, refused

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.parallel.claims import claimed, made_folder

HOLDER = """
import sys
from petscjam.parallel.claims import claimed
with claimed(sys.argv[1]):
    print("ready", flush=True)
    sys.stdin.readline()
"""
SHEAR = ["shear", "--particles", "36", "--rate", "1e-2", "--strain", "1", "--frames", "3"]


@pytest.fixture
def holder(environment):
    """Return a process that holds a claim until its input is closed."""
    started = []

    def hold(path):
        started.append(
            subprocess.Popen(
                [sys.executable, "-c", HOLDER, str(path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=environment,
                text=True,
            )
        )
        assert started[-1].stdout.readline() == "ready\n"
        return started[-1]

    yield hold
    for process in started:
        process.kill()
        process.communicate()


def test_a_claim_is_released(tmp_path):
    with claimed(tmp_path / "a"):
        assert (tmp_path / ".a.lock").exists()
    with pytest.raises(ZeroDivisionError), claimed(tmp_path / "a"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_process_may_claim_again_what_it_has(tmp_path):
    with claimed(tmp_path / "a"):
        with claimed(tmp_path / "a"):
            pass
        assert (tmp_path / ".a.lock").exists()


def test_a_forked_child_does_not_release(tmp_path, environment):
    code = """
import os, sys
from petscjam.parallel.claims import claimed
with claimed(sys.argv[1] + "/a"):
    if os.fork():
        os.wait()
        print(os.listdir(sys.argv[1]))
"""
    done = subprocess.run([sys.executable, "-c", code, tmp_path], env=environment, capture_output=True, text=True)
    assert done.stdout == "['.a.lock']\n", done.stderr


def test_a_link_is_what_it_points_to(tmp_path, holder):
    (tmp_path / "link").symlink_to(tmp_path / "a")
    holder(tmp_path / "a")
    with pytest.raises(InputError, match="another run"), claimed(tmp_path / "link"):
        pass


def test_another_run_is_named(tmp_path, holder):
    other = holder(tmp_path / "a")
    words = rf"a: another run \(process {other.pid} on .*\) writes to it$"
    with pytest.raises(InputError, match=words), claimed(tmp_path / "a"):
        pass
    other.communicate("")
    with claimed(tmp_path / "a"):
        pass


def test_a_run_that_was_killed_holds_nothing(tmp_path, holder):
    other = holder(tmp_path / "a")
    other.kill()
    other.wait()
    assert (tmp_path / ".a.lock").exists()
    with claimed(tmp_path / "a"):
        pass


def test_a_killed_run_that_nobody_has_waited_for_holds_nothing(tmp_path, holder):
    other = holder(tmp_path / "a")
    other.kill()
    os.waitid(os.P_PID, other.pid, os.WEXITED | os.WNOWAIT)  # it stays a zombie
    with claimed(tmp_path / "a"):
        pass


def test_the_number_of_a_process_may_come_back(tmp_path, holder):
    """The claim is that of an earlier process with the number of one that runs."""
    holder(tmp_path / "a")
    lock = tmp_path / ".a.lock"
    lock.write_text(json.dumps({**json.loads(lock.read_text()), "started": "1"}))
    with claimed(tmp_path / "a"):
        pass


@pytest.mark.parametrize("key", ["host", "in"])
def test_of_other_machines_nothing_is_known(tmp_path, holder, key):
    other = holder(tmp_path / "a")
    lock = tmp_path / ".a.lock"
    lock.write_text(json.dumps({**json.loads(lock.read_text()), key: "elsewhere"}))
    other.kill()
    other.wait()
    with pytest.raises(InputError, match=rf"if it has ended, remove {lock}"), claimed(tmp_path / "a"):
        pass


def test_a_claim_without_content_counts_no_more(tmp_path):
    """Of a run that was killed just then."""
    (tmp_path / ".a.lock").touch()
    with claimed(tmp_path / "a"):
        pass


@pytest.mark.parametrize("content", ["{}", "[1]", "nonsense", '{"process": "x"}'])
def test_what_is_no_claim_is_left_alone(tmp_path, content):
    (tmp_path / ".a.lock").write_text(content)
    with pytest.raises(InputError, match=r"\.a\.lock is not a claim"), claimed(tmp_path / "a"):
        pass
    assert (tmp_path / ".a.lock").read_text() == content


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("elsewhere")])
def test_claims_that_are_no_files(tmp_path, make):
    make(tmp_path / ".a.lock")
    with pytest.raises(InputError, match=r"a: .*\.a\.lock"), claimed(tmp_path / "a"):
        pass
    assert not (tmp_path / "elsewhere").exists()


RACE = """
import sys
from petscjam.base.errors import InputError
from petscjam.parallel.claims import claimed
for line in sys.stdin:
    try:
        with claimed(line.strip()):
            print("had", flush=True)
            sys.stdin.readline()
    except InputError as error:
        print("another run" in str(error) and "refused", flush=True)
"""


@pytest.mark.parametrize("left", [None, "", "killed"])
def test_of_four_at_once_one_has_it(tmp_path, environment, holder, left):
    """Whether there is nothing, or an empty claim, or one that counts no more."""
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", RACE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
            bufsize=1,
        )
        for _ in range(4)
    ]
    if left == "killed":
        other = holder(tmp_path / "old")
        other.kill()
        other.wait()
    for trial in range(20 if left != "" else 1):
        lock = tmp_path / f".{trial}.lock"
        if left is not None:
            lock.write_text("" if left == "" else (tmp_path / ".old.lock").read_text())
        for run in runs:
            run.stdin.write(f"{tmp_path / str(trial)}\n")
        said = [run.stdout.readline().strip() for run in runs]
        assert sorted(said) == ["had", *["refused"] * 3]
        runs[said.index("had")].stdin.write("\n")
    for run in runs:
        run.communicate("")


@pytest.mark.parallel(nprocs=2)
def test_rank_0_claims_for_all(comm, tmp_path):
    path = comm.bcast(tmp_path) / "a"
    with claimed(path, comm):
        owner = json.loads(path.with_name(".a.lock").read_text())["process"]
        assert owner == comm.bcast(os.getpid())
        comm.Barrier()
    comm.Barrier()
    assert not path.with_name(".a.lock").exists()


@pytest.mark.parallel(nprocs=[1, 2])
def test_a_refusal_is_that_of_all_ranks(comm, tmp_path):
    path = comm.bcast(tmp_path) / "a"
    if comm.rank == 0:
        owner = {"process": 1, "started": None, "host": "elsewhere", "in": ""}
        path.with_name(".a.lock").write_text(json.dumps(owner))
    with pytest.raises(InputError, match="process 1 on elsewhere"), claimed(path, comm):
        pass


def test_folders_that_were_made_for_nothing_go(tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError), made_folder(tmp_path / "there" / "a" / "b"):
        raise InputError("no")
    assert list(tmp_path.iterdir()) == [tmp_path / "there"]
    assert list((tmp_path / "there").iterdir()) == []


@pytest.fixture
def library(tmp_path):
    pj.prepare_library(tmp_path / "lib", [16], [1e-2], [1, 2])
    return tmp_path / "lib"


@pytest.mark.parametrize(
    "verb",
    [
        ["moduli"],
        ["nonaffine"],
        ["viscosity"],
        ["modes", "--count", "2"],
        ["density", "--moments", "16", "--vectors", "2"],
        ["correlations"],
        ["nonlinear-drag", "--stress", "1e-4"],
    ],
)
def test_results_are_claimed(library, tmp_path, holder, capfd, verb):
    holder(tmp_path / "r.h5")
    for options in [], ["--resume"], ["--overwrite"]:
        assert "another run" in refused(capfd, *verb, library, "-o", tmp_path / "r.h5", *options)
    assert not (tmp_path / "r.h5").exists()


@pytest.mark.parametrize("options", [[], ["--resume"], ["--overwrite"]])
def test_runs_and_frames_are_claimed(tmp_path, holder, capfd, options):
    other = holder(tmp_path / "r.h5")
    assert "r.h5: another run" in refused(capfd, *SHEAR, "-o", tmp_path / "r.h5", *options)
    other.communicate("")
    (tmp_path / "r.frames").mkdir()
    holder(tmp_path / "r.frames")
    assert "r.frames: another run" in refused(capfd, *SHEAR, "-o", tmp_path / "r.h5", *options)
    assert not (tmp_path / "r.h5").exists()


def test_folders_are_claimed(tmp_path, library, holder, capfd):
    holder(library)
    seeds = ["--seeds", "1:4"]
    prepare = ["prepare", "--particles", "16", *seeds, "-o", library, "--resume"]
    assert "lib: another run" in refused(capfd, *prepare)
    assert "lib: another run" in refused(capfd, *SHEAR, *seeds, "-o", library)
    assert len(list(library.iterdir())) == 5  # two packings, recipe, index, claim


def test_packings_are_claimed(tmp_path, holder, capfd):
    holder(tmp_path / "p.h5")
    assert "another run" in refused(capfd, "prepare", "--particles", 16, "-o", tmp_path / "p.h5")
    assert "another run" in refused(capfd, "import", SIXTEEN, "-o", tmp_path / "p.h5")
    assert not (tmp_path / "p.h5").exists()


def at_once(count, environment, *arguments):
    """Run the command so many times at once; return the status and the last line of errors of each."""
    command = [sys.executable, "-m", "petscjam", *map(str, arguments)]
    runs = [
        subprocess.Popen(command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for _ in range(count)
    ]
    errors = [run.communicate(timeout=300)[1] for run in runs]
    return [(run.returncode, error.strip()) for run, error in zip(runs, errors, strict=True)]


def lines_are_clear(said):
    """See that some runs did all of their work, and the others say in a line why they did not."""
    assert any(status == 0 for status, _ in said)
    for status, error in said:
        assert status == 0 or (status == 2 and "\n" not in error), error
        assert status == 0 or "another run" in error or "exists already" in error
    return True


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 4])
def test_moduli_at_once(library, tmp_path, environment, count):
    for trial in range(20):
        out = tmp_path / f"{trial}.h5"
        assert lines_are_clear(at_once(count, environment, "moduli", library, "--omega", "1", "-o", out))
        assert len(pj.read_moduli(out)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 4])
def test_runs_at_once(tmp_path, environment, count):
    assert main([*SHEAR, "-o", str(tmp_path / "alone.h5")]) == 0
    for trial in range(20):
        out = tmp_path / f"{trial}.h5"
        assert lines_are_clear(at_once(count, environment, *SHEAR, "-o", out))
        assert out.read_bytes() == (tmp_path / "alone.h5").read_bytes()
        assert len(list(out.with_suffix(".frames").iterdir())) == 3


def test_two_at_once(library, tmp_path, environment):
    out = tmp_path / "r.h5"
    assert lines_are_clear(at_once(2, environment, "moduli", library, "--omega", "1", "-o", out))
    assert len(pj.read_moduli(out)) == 2


NO_LOCKS = "#include <errno.h>\nint flock(int file, int how) { errno = ENOLCK; return -1; }\n"


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
def test_file_systems_without_locks(library, tmp_path, mpirun, environment):
    (tmp_path / "nolock.c").write_text(NO_LOCKS)
    preloaded = tmp_path / "nolock.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", preloaded, tmp_path / "nolock.c"], check=True)
    given = {**environment, "LD_PRELOAD": str(preloaded)}
    done = mpirun(2, "-m", "petscjam", "moduli", library, "--omega", "1", "-o", tmp_path / "r.h5", env=given)
    assert done.returncode == 0, done.stderr
    assert len(pj.read_moduli(tmp_path / "r.h5")) == 2
    assert main([*SHEAR, "-o", str(tmp_path / "run.h5")]) == 0
    command = [sys.executable, "-m", "petscjam", "info", tmp_path / "run.h5"]
    said = subprocess.run(command, env=given, capture_output=True, text=True, check=True).stdout
    assert "CD_rot" in said

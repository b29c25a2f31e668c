"""The verbs that ask many packings: stored, resumed, shared by ranks, refused, killed."""

import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
from helpers import names, refused

import petscjam as pj
from petscjam.analysis.viscosity import Viscosity
from petscjam.base.errors import InputError, SolverError
from petscjam.cli import main
from petscjam.io.jobs import Ensemble, PackingAnalysis, analyse
from petscjam.io.kinds import KINDS, class_of, recognise
from petscjam.io.results import inventory, read_results
from petscjam.response.origin import Result

OMEGA, STRESS, ALPHA = np.array([1e-3, 1.0]), 1e-3, 0.5
FREQUENCIES, AMPLITUDE = ["--omega", "1e-3,1"], ["--stress", "1e-3", "--alpha", "0.5"]
CONTACT, STOKES = {"damping": pj.ContactDamping()}, {"damping": pj.StokesDrag()}
VERBS = {
    "nonaffine": (["nonaffine"], pj.quasistatic_response, {}),
    "viscosity": (["viscosity", "--damping", "stokes"], pj.viscosity, STOKES),
    "aqs": (["aqs", "--step", "1e-2", "--events", "2"], pj.aqs, {"step": 1e-2, "events": 2}),
    "oscillations": (
        ["oscillate", "--amplitude", "1e-3", "--omega", "1", "--cycles", "3"],
        pj.oscillate,
        {"amplitudes": [1e-3], "omegas": [1.0], "cycles": 3, **CONTACT},
    ),
    "steps": (
        ["step-strain", "--step", "1e-3", "--time", "10,20"],
        pj.step_strain,
        {"steps": [1e-3], "times": [10.0, 20.0], **CONTACT},
    ),
    "modes": (["modes", "--count", "5"], pj.lowest_modes, {"count": 5}),
    "relaxations": (["modes", "--relaxation", "--count", "5"], pj.relaxation_modes, {"count": 5, **CONTACT}),
    "density": (["density", "--moments", "64", "--vectors", "4"], pj.density_of_states, {"moments": 64, "vectors": 4}),
    "correlations": (["correlations", *FREQUENCIES], pj.correlations, {"omegas": OMEGA, **CONTACT}),
    "drag": (
        ["nonlinear-drag", *FREQUENCIES, *AMPLITUDE],
        pj.self_consistent_drag,
        {"omegas": OMEGA, "stress": STRESS, "alpha": ALPHA},
    ),
    "uniform": (
        ["nonlinear-drag", "--uniform", *FREQUENCIES, *AMPLITUDE],
        pj.equivalent_drag,
        {"omegas": OMEGA, "stress": STRESS, "alpha": ALPHA},
    ),
    "direct": (
        ["nonlinear-drag", "--direct", *FREQUENCIES, *AMPLITUDE],
        pj.nonlinear_drag,
        {"omegas": OMEGA, "stress": STRESS, "alpha": ALPHA},
    ),
}
OTHERS = {
    "nonaffine": (["--strain-mode", "compression"], "strain=compression"),
    "viscosity": (["--strain-mode", "pure-shear"], "strain=pure-shear"),
    "aqs": (["--events", "3"], "events=3"),
    "oscillations": (["--cycles", "4"], "cycles=4"),
    "steps": (["--time", "10,30"], "times=[10.0, 30.0]"),
    "modes": (["--count", "6"], "count=6"),
    "relaxations": (["--count", "6"], "count=6"),
    "density": (["--seed", "2"], "seed=2"),
    "correlations": (["--width", "0.9"], "width=0.9"),
    "drag": (["--alpha", "0.6"], "alpha=0.6"),
    "uniform": (["--omega", "1e-3,2"], "omegas=[0.001, 2.0]"),
    "direct": (["--stress", "1e-2"], "stress=0.01"),
}
verbs = pytest.mark.parametrize("verb", VERBS)


def analysed(files, output, function, comm, log=lambda line: None, **options):
    return analyse(Ensemble(files, output), PackingAnalysis(function, options), comm=comm, log=log)


@pytest.fixture(scope="module")
def folder(three_packings):
    return three_packings


@pytest.fixture(scope="module")
def made(folder, tmp_path_factory):
    """Run a verb on all packings, once for all tests."""
    cache, place = {}, tmp_path_factory.mktemp("results")

    def make(verb):
        if verb not in cache:
            cache[verb] = place / f"{verb}.h5"
            assert main([*VERBS[verb][0], str(folder), "-o", str(cache[verb])]) == 0
        return cache[verb]

    return make


@pytest.fixture
def loose(folder, tmp_path):
    """Return a packing whose disks do not touch."""
    p = pj.Packing.read(folder / "p1.h5")
    pj.Packing(p.positions, p.radii / 2, p.box).write(tmp_path / "loose.h5")
    return tmp_path / "loose.h5"


def copy(file, tmp_path):
    (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path / file.name


def run(*arguments):
    return main([str(a) for a in arguments])


def assert_same(ours, theirs, rtol):
    """All fields but the cost; what is zero but for rounding is not compared to digits."""
    for item in fields(theirs):
        a, b = getattr(ours, item.name), getattr(theirs, item.name)
        if isinstance(b, pj.Packing):
            assert a.checksum == b.checksum
        elif item.name in ("residual", "residuals", "errors", "changes", "tau_changes"):
            assert np.nanmax(a, initial=0) < 1e-6
        elif isinstance(b, np.ndarray | float):
            scale = np.nanmax(abs(b), initial=0)
            assert np.allclose(a, b, rtol=rtol, atol=rtol * scale, equal_nan=True), item.name
        elif item.name != "performance":
            assert a == b, item.name


# --- what is made


@pytest.mark.parallel(nprocs=[1, 2, 3])
@verbs
def test_every_packing_gets_the_result_of_the_library(folder, tmp_path, comm, verb):
    from mpi4py import MPI

    arguments, analyse, settings = VERBS[verb]
    output = comm.bcast(tmp_path / "out.h5")
    assert run(*arguments, folder, "-o", output) == 0
    results = read_results(output)
    assert {r.origin.name for r in results.values()} == {"p1", "p2", "p3"}
    for name, ours in list(results.items())[comm.rank :: comm.size]:
        packing = pj.Packing.read(folder / f"{ours.origin.name}.h5")
        assert name.startswith(f"{ours.origin.name}-{packing.checksum[:8]}")
        theirs = analyse(packing, **settings, name=ours.origin.name, comm=MPI.COMM_SELF)
        assert type(ours) is type(theirs)
        assert_same(ours, theirs, 1e-12)
    comm.barrier()
    assert [file.name for file in output.parent.iterdir()] == ["out.h5"]


def test_a_group_says_what_it_was_made_with(made):
    said = {item.made_with for item in inventory(made("density"))}
    assert said == {"density_of_states(moments=64, vectors=4, seed=1)"}


@verbs
def test_an_inventory_is_what_the_results_say(made, verb):
    results = read_results(made(verb))
    assert {item.name for item in inventory(made(verb))} == set(results)
    for item in inventory(made(verb)):
        r = results[item.name]
        assert item.checksum == r.origin.checksum
        assert item.damping == str(r.origin.damping)
        assert item.prestress is r.prestress


@verbs
def test_info_has_a_line_for_every_packing(made, capsys, verb):
    results = read_results(made(verb))
    capsys.readouterr()
    assert run("info", made(verb)) == 0
    units, heads, *lines = capsys.readouterr().out.splitlines()
    assert units.startswith(next(iter(results.values())).units)
    assert heads.split()[:3] == ["packing", "N", "p"]
    rows = [line for line in lines if not line.startswith(" ")]
    assert all(row.startswith(f"{name} ") for row, name in zip(rows, results, strict=True))


@verbs
def test_plot_draws_it(made, tmp_path, verb):
    from PIL import Image

    assert run("plot", made(verb), "-o", tmp_path / "out.png") == 0
    colours = np.asarray(Image.open(tmp_path / "out.png").convert("L"))
    assert colours.std() > 1  # not blank


def test_every_kind_of_result_has_a_table():
    for kind in KINDS:
        assert class_of(kind) is pj.ComplexModulus or (class_of(kind).units and class_of(kind).row is not Result.row)


def test_a_file_made_under_the_former_name_is_resumed(folder, tmp_path, comm):
    files, output = [folder / "p1.h5"], tmp_path / "sums.h5"
    with pytest.warns(FutureWarning, match="now called mode_sum"):
        analysed(files, output, pj.rebuilt_response, comm, count=5)
    again = PackingAnalysis(pj.mode_sum, {"count": 5})
    assert analyse(Ensemble(files, output, resume=True), again, comm=comm, log=lambda line: None) == (0, [])


def test_a_kind_without_a_picture_says_so(folder, tmp_path, capfd, comm):
    output = tmp_path / "rebuilt.h5"
    analysed([folder / "p1.h5"], output, pj.mode_sum, comm, count=5)
    (kind,) = {type(r) for r in read_results(output).values()}
    assert not kind.figure
    assert kind.__name__ in refused(capfd, "plot", output, "-o", tmp_path / "out.png")


def test_results_in_the_folder_are_not_packings(folder, made, tmp_path):
    for file in folder.iterdir():
        copy(file, tmp_path)
    copy(made("viscosity"), tmp_path)
    assert run("nonaffine", tmp_path, "-o", tmp_path / "nonaffine.h5") == 0
    assert recognise(tmp_path / "viscosity.h5") == "results"
    assert len(read_results(tmp_path / "nonaffine.h5")) == 3


def test_laws_and_prestress_side_by_side(folder, tmp_path):
    packing = folder / "p1.h5"
    arguments = ["viscosity", packing, "--beta", "0.1,1", "--prestress-both", "-o", tmp_path / "v.h5"]
    assert run(*arguments) == 0
    results = read_results(tmp_path / "v.h5")
    for v in results.values():
        direct = pj.viscosity(pj.Packing.read(packing), damping=v.damping, prestress=v.prestress)
        assert v.eta0 == pytest.approx(direct.eta0, rel=1e-12)
    assert {(v.damping.beta, v.prestress) for v in results.values()} == {
        (0.1, True),
        (0.1, False),
        (1.0, True),
        (1.0, False),
    }


# --- what is there already


@verbs
def test_resume_makes_nothing_again(folder, made, verb):
    before = made(verb).read_bytes()
    assert run(*VERBS[verb][0], folder, "-o", made(verb), "--resume") == 0
    assert made(verb).read_bytes() == before


@verbs
def test_resume_refuses_other_settings(folder, made, capfd, verb):
    arguments, file = VERBS[verb][0], made(verb)
    other, named = OTHERS[verb]
    before = file.read_bytes()
    assert named in refused(capfd, *arguments, *other, folder, "-o", file, "--resume")
    assert file.read_bytes() == before


def test_resume_adds_the_packings_that_are_missing(folder, tmp_path, capsys):
    output = tmp_path / "v.h5"
    run("viscosity", folder / "p2.h5", "-o", output)
    first = read_results(output)
    capsys.readouterr()
    assert run("viscosity", folder, "-o", output, "--resume") == 0
    log = [line for line in capsys.readouterr().out.splitlines() if line.endswith(" s")]
    assert [line[:2] for line in log] == ["p1", "p3"]
    results = read_results(output)
    assert sorted(v.origin.name for v in results.values()) == ["p1", "p2", "p3"]
    assert all(results[name].eta0 == v.eta0 for name, v in first.items())


def test_resume_adds_the_other_prestress(folder, tmp_path):
    output = tmp_path / "v.h5"
    run("viscosity", folder / "p1.h5", "-o", output)
    assert run("viscosity", folder / "p1.h5", "--prestress-both", "-o", output, "--resume") == 0
    assert [v.prestress for v in read_results(output).values()].count(True) == 1
    assert len(read_results(output)) == 2


@pytest.mark.parametrize(
    "other", [["--beta", "0.5"], ["--no-prestress"], ["--damping", "stokes"]], ids=["beta", "pre-stress", "law"]
)
def test_resume_adds_another_law_or_prestress_beside(folder, tmp_path, other):
    output, packing = tmp_path / "v.h5", folder / "p1.h5"
    run("viscosity", packing, "-o", output)
    (first,) = read_results(output).values()
    assert run("viscosity", packing, *other, "-o", output, "--resume") == 0
    results = list(read_results(output).values())
    assert len({(str(v.damping), v.prestress) for v in results}) == len(results) == 2
    for v in results:
        direct = pj.viscosity(pj.Packing.read(packing), damping=v.damping, prestress=v.prestress)
        assert v.eta0 == pytest.approx(direct.eta0, rel=1e-12)
    assert first.eta0 in [v.eta0 for v in results]


@pytest.mark.parametrize(
    ("first", "then"),
    [
        ("drag", ["nonlinear-drag", "--uniform", *FREQUENCIES, *AMPLITUDE]),
        ("nonaffine", ["viscosity"]),
        ("uniform", ["nonlinear-drag", *FREQUENCIES, *AMPLITUDE]),
        ("modes", ["modes", "--relaxation", "--count", "5"]),
        ("nonaffine", ["moduli", "--omega", "1,2"]),
    ],
    ids=["form", "kind", "other form", "relaxation", "moduli"],
)
def test_resume_refuses_what_answers_another_question(folder, made, tmp_path, capfd, first, then):
    output = copy(made(first), tmp_path)
    before = output.read_bytes()
    assert output.name in refused(capfd, *then, folder, "-o", output, "--resume")
    assert output.read_bytes() == before


def test_resume_refuses_moduli(folder, tmp_path, capfd):
    run("moduli", folder / "p1.h5", "--omega", "1,2", "-o", tmp_path / "g.h5")
    message = refused(capfd, "viscosity", folder, "-o", tmp_path / "g.h5", "--resume")
    assert "g.h5" in message


@verbs
def test_an_output_that_exists_is_refused_and_kept(folder, made, capfd, verb):
    before = made(verb).read_bytes()
    message = refused(capfd, *VERBS[verb][0], folder, "-o", made(verb))
    assert str(made(verb)) in message
    assert "exists" in message
    assert made(verb).read_bytes() == before


def test_overwrite_replaces_results_of_another_kind(folder, made, tmp_path):
    output = copy(made("modes"), tmp_path)
    assert run("viscosity", folder / "p1.h5", "-o", output, "--overwrite") == 0
    assert [type(r) for r in read_results(output).values()] == [Viscosity]


# --- what cannot be


def said(x):
    return x if isinstance(x, str) else " ".join(x)


BAD = [
    (["modes", "--count", "0"], "count"),
    (["modes", "--relaxation", "--count", "0"], "count"),
    (["density", "--moments", "1"], "moments"),
    (["density", "--vectors", "0"], "vectors"),
    (["correlations", "--width", "0"], "width"),
    (["correlations", "--bin", "0"], "bin"),
    (["nonlinear-drag", "--stress", "0"], "stress"),
    (["nonlinear-drag", "--stress", "1e-3", "--alpha", "-1"], "alpha"),
    (["nonlinear-drag", "--uniform", "--stress", "0"], "stress"),
    (["nonlinear-drag", "--uniform", "--stress", "1e-3", "--alpha", "0"], "alpha"),
]
BAD_WORDS = [
    (["nonlinear-drag", "--stress", "1e-3", "--omega", "0"], "--omega: 0"),
    (["nonlinear-drag", *FREQUENCIES], "--stress"),
    (["nonlinear-drag", "--stress", "1e-3", "--beta", "1"], "--beta"),
    (["correlations", "--omega", "0"], "--omega: 0"),
    (["correlations", "--strain-mode", "compression"], "--strain-mode"),
    (["correlations", "--width", "100"], "width"),
    (["nonaffine", "--strain-mode", "torsion"], "torsion"),
    (["modes", "--strain-mode", "torsion"], "torsion"),
    (["viscosity", "--beta", "-1"], "-1"),
    (["viscosity", "--damping", "glue"], "glue"),
    (["modes", "--count", "many"], "many"),
    (["viscosity", "--team-size", "0"], "--team-size"),
    (["density", "--no-prestress", "--prestress-both"], "--prestress-both"),
]


@pytest.mark.parametrize(("arguments", "named"), BAD + BAD_WORDS, ids=said)
def test_bad_values(folder, tmp_path, capfd, arguments, named):
    assert names(refused(capfd, *arguments, folder / "p1.h5", "-o", tmp_path / "out.h5"), named)
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.parametrize(("arguments", "named"), BAD, ids=said)
def test_bad_values_are_said_once_for_many_packings(folder, tmp_path, capfd, arguments, named):
    assert names(refused(capfd, *arguments, folder, "-o", tmp_path / "out.h5"), named)


def test_a_folder_without_packings(tmp_path, capfd):
    assert str(tmp_path) in refused(capfd, "viscosity", tmp_path, "-o", tmp_path / "out.h5")


def test_a_packing_that_is_missing(folder, tmp_path, capfd):
    message = refused(capfd, "viscosity", folder, tmp_path / "gone.h5", "-o", tmp_path / "out.h5")
    assert "gone.h5" in message
    assert not (tmp_path / "out.h5").exists()


@verbs
def test_a_packing_that_cannot_be_solved_stops_no_other(folder, loose, tmp_path, capfd, verb):
    output = tmp_path / "out.h5"
    assert run(*VERBS[verb][0], loose, folder, "-o", output) == 1
    err = capfd.readouterr().err
    assert "1 results failed" in err
    assert f"{loose}: " in err
    assert "no contacts" in err
    assert len(read_results(output)) == 3


def test_a_packing_that_still_cannot_be_solved_fails_as_before(folder, loose, tmp_path, capfd):
    arguments = ["viscosity", loose, folder, "-o", tmp_path / "out.h5"]
    assert run(*arguments) == 1
    capfd.readouterr()
    assert run(*arguments, "--resume") == 1
    assert "1 results failed" in capfd.readouterr().err


def test_one_packing_that_cannot_be_solved_is_one_line(loose, tmp_path, capfd):
    assert "no contacts" in refused(capfd, "viscosity", loose, "-o", tmp_path / "out.h5")


def test_a_failure_of_the_numerics_is_told_like_bad_input(folder, tmp_path, comm):
    def shore(packing, *, name, **_):
        if name == "p2":
            raise SolverError("the tide was high")
        return pj.viscosity(packing, name=name)

    files = sorted(folder.glob("*.h5"))
    made, failures = analysed(files, tmp_path / "v.h5", shore, comm)
    assert made == 2
    assert failures == ["the tide was high"]


def test_bad_input_of_one_packing_names_its_file(folder, tmp_path, comm):
    def shore(packing, *, name, **_):
        if name == "p2":
            raise InputError("too loose")
        return pj.viscosity(packing, name=name)

    files = sorted(folder.glob("*.h5"))
    _, failures = analysed(files, tmp_path / "v.h5", shore, comm)
    assert failures == [f"{folder / 'p2.h5'}: too loose"]


# --- ranks


@pytest.mark.parallel(nprocs=[2, 3])
def test_every_rank_has_its_share(folder, tmp_path, comm):
    lines = []
    files, output = sorted(folder.glob("*.h5")), comm.bcast(tmp_path / "v.h5")
    made, failures = analysed(files, output, pj.viscosity, comm, log=lines.append)
    assert (made, failures) == (3, [])
    shares = comm.allgather(len(lines))
    assert sum(shares) == 3
    assert min(shares) >= 1
    assert {v.origin.name for v in read_results(output).values()} == {"p1", "p2", "p3"}


@pytest.mark.parallel(nprocs=2)
@verbs
def test_a_team_of_two_finds_the_same(folder, tmp_path, comm, verb):
    from mpi4py import MPI

    arguments, analyse, settings = VERBS[verb]
    output = comm.bcast(tmp_path / "out.h5")
    assert run(*arguments, folder / "p1.h5", "--team-size", 2, "-o", output) == 0
    (ours,) = read_results(output).values()
    if hasattr(ours, "performance"):
        assert ours.performance["ranks"] == 2
    theirs = analyse(pj.Packing.read(folder / "p1.h5"), **settings, name="p1", comm=MPI.COMM_SELF)
    assert_same(ours, theirs, 1e-7)


@pytest.mark.parallel(nprocs=2)
def test_a_failure_on_one_rank_is_known_to_all(folder, loose, tmp_path, comm):
    loose, output = comm.bcast(loose), comm.bcast(tmp_path / "v.h5")
    files = [loose, *sorted(folder.glob("*.h5"))]
    made, failures = analysed(files, output, pj.viscosity, comm)
    assert made == 3
    assert len(failures) == 1
    assert failures == comm.bcast(failures)


def test_mpirun_finds_the_same_as_one_rank(folder, made, mpirun, tmp_path):
    arguments = ["-m", "petscjam", *VERBS["modes"][0], folder, "-o", tmp_path / "out.h5"]
    done = mpirun(2, *arguments)
    assert done.returncode == 0, done.stderr
    expected, results = read_results(made("modes")), read_results(tmp_path / "out.h5")
    assert results.keys() == expected.keys()
    for name, ours in results.items():
        assert_same(ours, expected[name], 1e-12)


# --- kill -9

DIES = """
import os, sys
import petscjam.io.jobs as ensemble
from petscjam.cli import main
append, written = ensemble.append_result, []
def last(*arguments, **options):
    append(*arguments, **options)
    written.append(0)
    if len(written) == int(sys.argv[1]):
        os.kill(os.getpid(), 9)
ensemble.append_result = last
main(sys.argv[2:])
"""


@pytest.mark.parametrize("results", [1, 2])
def test_a_killed_run_goes_on_to_the_same_results(folder, made, tmp_path, environment, results):
    output = tmp_path / "out.h5"
    arguments = [*VERBS["modes"][0], str(folder), "-o", str(output)]
    command = [sys.executable, "-c", DIES, str(results), *arguments]
    dead = subprocess.run(command, env=environment, capture_output=True, timeout=120)
    assert dead.returncode == -9
    assert len(read_results(output)) == results
    assert run(*arguments, "--resume") == 0
    expected = read_results(made("modes"))
    assert list(read_results(output)) == list(expected)
    for name, ours in read_results(output).items():
        assert_same(ours, expected[name], 1e-14)

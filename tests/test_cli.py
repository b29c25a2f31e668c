"""The command as a user types it: what it makes, and how it refuses."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import SIXTEEN, jax_md, names, refused

import petscjam as pj
from petscjam.base.files import atomic_h5
from petscjam.cli import main


@pytest.fixture
def packing(tmp_path):
    path = tmp_path / "sixteen.h5"
    assert main(["import", str(SIXTEEN), "-o", str(path)]) == 0
    return path


def test_moduli_are_those_of_the_library(packing, tmp_path):
    out = tmp_path / "g.h5"
    assert main(["moduli", str(packing), "--omega", "1e-3:10:5", "--beta", "0.1", "-o", str(out)]) == 0
    omega = [1e-3, 1e-2, 1e-1, 1.0, 10.0]
    expected = pj.complex_modulus(pj.Packing.read(packing), omega, damping=pj.ContactDamping(0.1))
    g = pj.read_modulus(out)
    assert (abs(g.values / expected.values - 1) <= g.errors + 1e-12).all()


def test_direct_moduli_are_those_of_the_library(packing, tmp_path):
    out = tmp_path / "g.h5"
    arguments = ["moduli", str(packing), "--omega", "1e-3:10:5", "--beta", "0.1", "--direct", "-o", str(out)]
    assert main(arguments) == 0
    omega = [1e-3, 1e-2, 1e-1, 1.0, 10.0]
    expected = pj.complex_modulus(pj.Packing.read(packing), omega, damping=pj.ContactDamping(0.1))
    assert (pj.read_modulus(out).values == expected.values).all()


def test_a_result_reads_back_as_it_was_written(packing, tmp_path):
    from dataclasses import fields

    from petscjam.io.results import append_result

    g = pj.complex_modulus(pj.Packing.read(packing), [0.1, 1.0], fields_at=[1.0], name="sixteen")
    append_result(g, tmp_path / "g.h5", "sixteen")
    back = pj.read_modulus(tmp_path / "g.h5")
    for item in fields(g):
        if item.name in ("errors", "part_errors"):  # not known where each frequency is solved for
            assert np.isnan(getattr(back, item.name)).all()
        elif item.name not in ("geometry", "performance"):
            assert np.array_equal(getattr(back, item.name), getattr(g, item.name)), item.name
    assert back.geometry.checksum == g.geometry.checksum
    assert back.performance["factorisations"] == 2


def test_frequencies_as_a_list(packing, tmp_path):
    out = tmp_path / "g.h5"
    assert main(["moduli", str(packing), "--omega", "0.5,2,7", "-o", str(out)]) == 0
    assert pj.read_modulus(out).omega.tolist() == [0.5, 2.0, 7.0]


def test_the_figure_is_a_picture_with_the_fields(packing, tmp_path):
    out, figure = tmp_path / "g.h5", tmp_path / "g.png"
    main(["moduli", str(packing), "--omega", "1e-3:10:5", "--fields", "1e-3,10", "-o", str(out)])
    assert main(["plot", str(out), "-o", str(figure)]) == 0
    from PIL import Image

    width, height = Image.open(figure).size
    assert height > width  # the moduli above, two rows of fields below


def test_table_flags_an_unstable_packing(tmp_path, capsys):
    grid = 0.99 * np.mgrid[0:4, 0:4].reshape(2, -1).T
    pj.Packing(grid, np.full(16, 0.5), pj.Box.square(3.96)).write(tmp_path / "lattice.h5")
    main(["moduli", str(tmp_path / "lattice.h5"), "--omega", "1", "-o", str(tmp_path / "g.h5")])
    assert "UNSTABLE: G0 < 0" in capsys.readouterr().out
    assert not pj.read_modulus(tmp_path / "g.h5").stable
    assert main(["export", str(tmp_path / "g.h5"), "-o", str(tmp_path / "g.csv")]) == 0
    assert "g.csv: UNSTABLE: G0 < 0" in capsys.readouterr().err


def test_resume_adds_only_what_is_missing(packing, tmp_path):
    out, second = tmp_path / "g.h5", tmp_path / "jaxmd.h5"
    jax_md().write(second)
    main(["moduli", str(packing), "--omega", "1,2", "-o", str(out)])
    with atomic_h5(out, existing=True) as h5:
        next(iter(h5.values())).attrs["G0"] = 42.0  # a mark, to see that it is not computed again
    assert main(["moduli", str(packing), str(second), "--omega", "1,2", "-o", str(out), "--resume"]) == 0
    results = list(pj.read_moduli(out).values())
    assert sorted(g.origin.particles for g in results) == [16, 64]
    assert 42.0 in [g.G0 for g in results]


def test_resume_refuses_other_settings(packing, tmp_path, capfd):
    out = tmp_path / "g.h5"
    main(["moduli", str(packing), "--omega", "1,2", "-o", str(out)])
    capfd.readouterr()
    assert "beta=0.5" in refused(capfd, "moduli", packing, "--omega", "1,2", "--beta", 0.5, "-o", out, "--resume")
    assert "omega" in refused(capfd, "moduli", packing, "--omega", "1,3", "-o", out, "--resume")


def test_an_output_that_exists_is_refused_and_kept(packing, tmp_path, capfd):
    out = tmp_path / "g.h5"
    main(["moduli", str(packing), "--omega", "1,2", "-o", str(out)])
    before = out.read_bytes()
    capfd.readouterr()
    assert str(out) in refused(capfd, "moduli", packing, "-o", out)
    assert out.read_bytes() == before


def test_overwrite_keeps_the_old_file_until_there_is_a_new_result(packing, tmp_path, capfd):
    out, loose = tmp_path / "g.h5", tmp_path / "loose.h5"
    main(["moduli", str(packing), "--omega", "1,2", "-o", str(out)])
    before = out.read_bytes()
    p = pj.Packing.read(packing)
    pj.Packing(p.positions, p.radii / 2, p.box).write(loose)
    capfd.readouterr()
    assert "no contacts" in refused(capfd, "moduli", loose, "-o", out, "--overwrite")
    assert out.read_bytes() == before


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--beta", "-1"], "-1"),
        (["--damping", "stokes", "--eta-fluid", "-2"], "-2"),
        (["--omega", "0:1:5"], "--omega: 0 is not"),
        (["--omega=-1:1:5"], "-1"),
        (["--omega", "-1:1:5"], "-1"),
        (["--omega", "1:0.1:5"], "1:0.1:5"),
        (["--omega", "1:10:0"], "1:10:0"),
        (["--omega", "fast"], "fast"),
        (["--omega", ""], "''"),
        (["--bta", "1"], "--beta"),
        (["--eta-fluid", "1"], "--eta-fluid"),
        (["--beta", "much"], "much"),
        (["--damping", "stokes", "--beta", "1"], "--beta"),
        (["--damping", "glue"], "glue"),
        (["--strain-mode", "torsion"], "torsion"),
        (["--fields", "1e6"], "1e+06"),
        (["--omega", "1:10:99999999999"], "99999999999"),
    ],
)
def test_bad_options(packing, tmp_path, capfd, options, named):
    capfd.readouterr()
    assert names(refused(capfd, "moduli", packing, "-o", tmp_path / "g.h5", *options), named)
    assert not (tmp_path / "g.h5").exists()


def truncated(path):
    path.write_bytes(path.read_bytes()[:-1000])


def other_schema(path):
    with atomic_h5(path) as h5:
        h5["temperature"] = 1.0


def not_a_number(path):
    with atomic_h5(path, existing=True) as h5:
        h5["particles/trajectory/position/value"][0, 3, 1] = np.nan


def negative_radius(path):
    with atomic_h5(path, existing=True) as h5:
        h5["particles/trajectory/radius"][3] = -1.0


@pytest.mark.parametrize("spoil", [Path.unlink, truncated, other_schema, not_a_number, negative_radius])
@pytest.mark.parametrize("verb", ["moduli", "info", "export"])
def test_bad_packings(packing, tmp_path, capfd, spoil, verb):
    spoil(packing)
    capfd.readouterr()
    arguments = {"moduli": ["-o", tmp_path / "g.h5"], "info": [], "export": ["-o", tmp_path / "p.xyz"]}[verb]
    assert packing.name in refused(capfd, verb, packing, *arguments)
    assert list(tmp_path.glob("g.h5")) + list(tmp_path.glob("p.xyz")) == []


def two_pieces(tmp_path):
    """Two square lattices, each under pressure, out of each other's reach."""
    grid = 0.49 * np.mgrid[0:3, 0:3].reshape(2, -1).T
    far = grid + np.array([0.0, 4.0])
    path = tmp_path / "pieces.h5"
    cell = np.array([[3 * 0.49, 0.0], [0.0, 8.0]])
    pj.Packing(np.concatenate([grid, far]), np.full(18, 0.25), pj.Box(cell)).write(path)
    return path


def test_a_network_in_pieces(tmp_path, capfd):
    message = refused(capfd, "moduli", two_pieces(tmp_path), "-o", tmp_path / "g.h5")
    assert "2 pieces" in message
    assert "pieces.h5" in message


def test_disk_full(packing, tmp_path, environment):
    """A limit on the size of files stands for a full disk; nothing is lost, nothing half-written."""
    out = tmp_path / "g.h5"
    main(["moduli", str(packing), "--omega", "1,2", "-o", str(out)])
    before = out.read_bytes()
    script = (
        "import resource, signal, sys; from mpi4py import MPI; from petscjam.cli import main;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({len(before) // 2},) * 2);"
        f"sys.exit(main(['moduli', {str(packing)!r}, '--omega', '1,2', '-o', {str(out)!r}, '--overwrite']))"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, env=environment)
    assert run.returncode == 2, run.stderr
    assert run.stderr.splitlines()[-1].startswith(f"petscjam: {out}: ")
    assert out.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([out.name, packing.name])


def test_ranges_share_their_points():
    from petscjam.base.arguments import points

    assert set(points("1e-2:1e-3:4")) < set(points("1e-1:1e-3:7"))


def test_prepare_many_seeds_and_resume(tmp_path):
    folder = tmp_path / "library"
    arguments = ["prepare", "--particles", "32", "--pressure", "1e-2", "--seeds", "1:2", "-o", str(folder)]
    assert main(arguments) == 0
    first = sorted(folder.glob("*.h5"))
    stamps = [os.stat(p).st_mtime_ns for p in first]
    assert main([*arguments[:6], "1:3", *arguments[7:], "--resume"]) == 0
    assert len(list(folder.glob("*.h5"))) == 3
    assert [os.stat(p).st_mtime_ns for p in first] == stamps


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--pressure", "-1"], "-1"),
        (["--particles", "3"], "3"),
        (["--seeds", "5:1"], "5:1"),
        (["--seeds", "1:99999999999"], "99999999999"),
        (["--method", "magic"], "magic"),
        (["--pressure", "1e-3,0"], "--pressure: 0 is not"),
        (["--pressure", "1e-2:1e-3"], "1e-2:1e-3"),
        (["--particles", "64,3"], "3"),
        (["--particles", "many"], "many"),
        (["--ratio", "0"], "ratio"),
        (["--potential", "glue"], "glue"),
        (["--budget", "0"], "budget"),
        (["--pressure", "1e-2,0.01"], "N1024_p0.01_s0001.h5"),
        (["--seed", "1", "--seeds", "1:2"], "--seed"),
    ],
)
def test_prepare_refuses(tmp_path, capfd, options, named):
    assert names(refused(capfd, "prepare", *options, "-o", tmp_path / "p.h5"), named)


def test_info_says_what_was_certified(tmp_path, capsys):
    out = tmp_path / "p.h5"
    main(["prepare", "--particles", "16", "--pressure", "1e-2", "-o", str(out)])
    certificate = pj.Packing.read(out).certificate
    assert certificate.shear_modulus < 0
    capsys.readouterr()
    main(["info", str(out)])
    text = capsys.readouterr().out
    for said in (
        "proved minimum     yes",
        "zero modes         0",
        f"{certificate.contacts} in the backbone",
        f"{certificate.lowest_eigenvalue:.6g} ±",
        "UNSTABLE against shear",
    ):
        assert said in text, said


def test_info_shows_the_measured_pressure_whatever_the_origin_says(packing, tmp_path, capsys):
    """A packing relaxed at constant volume has no target; a foreign file may say anything."""
    p = pj.relax_packing(pj.Packing.read(packing))
    said = {**p.provenance, "checksum": "fake", "proved minimum": "no", "disks": "1\npressure 7"}
    pj.Packing(p.positions, p.radii, p.box, certificate=p.certificate, provenance=said).write(tmp_path / "relaxed.h5")
    capsys.readouterr()
    main(["info", str(tmp_path / "relaxed.h5")])
    measured, made_with = capsys.readouterr().out.split("\nmade with\n")
    lines = {line[:18].rstrip(): line[19:] for line in measured.splitlines()}
    assert float(lines["pressure"].split()[0]) == pytest.approx(1e-3, rel=1e-6)
    assert lines["checksum"] == p.checksum
    assert lines["proved minimum"] == "yes"
    assert "  target pressure  None\n" in made_with
    assert "  disks            1 pressure 7" in made_with.splitlines()


def test_an_imported_packing_is_judged(packing, capsys):
    assert pj.Packing.read(packing).certificate.proved
    main(["info", str(packing)])
    assert "UNSTABLE" not in capsys.readouterr().out


def test_a_packing_that_is_not_jammed_is_imported_with_a_warning(packing, tmp_path, capfd):
    p, loose, out = pj.Packing.read(packing), tmp_path / "loose.xyz", tmp_path / "loose.h5"
    pj.export_packing(pj.Packing(p.positions, p.radii / 2, p.box), loose)
    capfd.readouterr()
    assert main(["import", str(loose), "-o", str(out)]) == 0
    assert f"warning: {loose} is not judged: " in capfd.readouterr().err
    assert pj.Packing.read(out).certificate == pj.Certificate()


def test_an_imported_packing_is_relaxed_on_request(packing, tmp_path):
    p, shaken, out = pj.Packing.read(packing), tmp_path / "shaken.xyz", tmp_path / "out.h5"
    shift = 1e-3 * np.random.default_rng(0).standard_normal(p.positions.shape)
    pj.export_packing(pj.Packing(p.positions + shift, p.radii, p.box), shaken)
    main(["import", str(shaken), "-o", str(out)])
    assert not pj.Packing.read(out).certificate.proved
    assert main(["import", str(shaken), "--relax", "-o", str(out), "--overwrite"]) == 0
    relaxed = pj.Packing.read(out)
    assert relaxed.certificate.proved
    assert (relaxed.box.cell == p.box.cell).all()
    options = ["--relax", "--pressure", "2e-3", "--shear-stabilised", "--overwrite"]
    assert main(["import", str(shaken), *options, "-o", str(out)]) == 0
    certificate = pj.Packing.read(out).certificate
    assert certificate.proved
    assert certificate.pressure == pytest.approx(2e-3, rel=1e-9)
    assert certificate.shear_modulus > 0


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--pressure", "1e-3"], "--relax"),
        (["--shear-stabilised"], "--relax"),
        (["--relax", "--pressure", "-1"], "-1"),
        (["--potential", "hertzian"], "hertzian"),
        (["--potential", "glue"], "glue"),
    ],
)
def test_import_refuses(tmp_path, capfd, options, named):
    assert names(refused(capfd, "import", SIXTEEN, *options, "-o", tmp_path / "p.h5"), named)
    assert not (tmp_path / "p.h5").exists()


@pytest.mark.parametrize("verb", ["prepare", "info", "import", "export", "moduli", "plot"])
def test_help(verb, capsys):
    with pytest.raises(SystemExit) as stop:
        main([verb, "--help"])
    assert stop.value.code == 0
    assert "usage: petscjam" in capsys.readouterr().out


def test_petsc_options_reach_petsc(packing, tmp_path, environment):
    out = tmp_path / "g.h5"
    arguments = ["moduli", packing, "--omega", "1", "-o", out, "--", "-log_view"]
    run = subprocess.run(
        [sys.executable, "-m", "petscjam", *arguments], capture_output=True, text=True, timeout=120, env=environment
    )
    assert run.returncode == 0, run.stderr
    assert "petscjam: factor" in run.stdout


def test_mpirun_gives_the_same_result(packing, tmp_path, mpirun):
    one, two = tmp_path / "one.h5", tmp_path / "two.h5"
    assert main(["moduli", str(packing), "--omega", "1e-3:10:5", "-o", str(one)]) == 0
    run = mpirun(2, "-m", "petscjam", "moduli", packing, "--omega", "1e-3:10:5", "-o", two)
    assert run.returncode == 0, run.stderr
    assert pj.read_modulus(two).values == pytest.approx(pj.read_modulus(one).values, rel=1e-10)


def test_mpirun_bad_input_ends_every_rank_with_one_message(packing, tmp_path, mpirun):
    run = mpirun(3, "-m", "petscjam", "moduli", packing, "--beta", "-1", "-o", tmp_path / "g.h5", timeout=60)
    assert run.returncode == 2
    assert run.stderr.count("petscjam: ") == 1


def test_mpirun_prepare_refuses_with_one_message(tmp_path, mpirun):
    arguments = ["prepare", "--particles", 4, "--seeds", "1:1", "-o", tmp_path / "library"]
    run = mpirun(2, "-m", "petscjam", *arguments, timeout=60)
    assert run.returncode == 2
    assert run.stderr.count("petscjam: ") == 1
    assert "(rank" not in run.stderr
    assert not (tmp_path / "library").exists()


def test_mpirun_with_work_for_one_rank_only(packing, tmp_path, mpirun):
    """PETSc starts on all ranks together, or waits forever."""
    one, two, three = (tmp_path / f"{name}.h5" for name in ("one", "two", "three"))
    settings = ["--particles", "16", "--pressure", "1e-2"]
    assert main(["prepare", *settings, "-o", str(one)]) == 0
    for arguments in (["prepare", *settings, "-o", two], ["import", SIXTEEN, "--relax", "-o", three]):
        run = mpirun(2, "-m", "petscjam", *arguments, timeout=60)
        assert run.returncode == 0, run.stderr
    assert one.read_bytes() == two.read_bytes()
    assert pj.Packing.read(three).certificate.proved


def test_mpirun_help_prints_once(mpirun):
    assert mpirun(2, "-m", "petscjam", "--help").stdout.count("usage:") == 1


def test_an_exception_on_one_rank_ends_all(packing, tmp_path, mpirun):
    """Rank 1 fails in the middle of a sweep, where rank 0 waits for it."""
    script = (
        "import sys; from mpi4py import MPI; import petscjam.parallel.solver as s\n"
        "from petscjam.cli import main\n"
        "solve = s.DirectSolver.solve\n"
        "def fails(self, *rhs, **options):\n"
        "    if MPI.COMM_WORLD.rank == 1: raise RuntimeError('injected')\n"
        "    return solve(self, *rhs, **options)\n"
        "s.DirectSolver.solve = fails\n"
        f"sys.exit(main(['moduli', {str(packing)!r}, '--omega', '1', '-o', {str(tmp_path / 'g.h5')!r}]))"
    )
    run = mpirun(2, "-c", script, timeout=30)
    assert run.returncode == 1
    assert "RuntimeError: injected" in run.stderr
    assert "(rank 1 of 2)" in run.stderr


def test_a_killed_run_leaves_whole_results(packing, tmp_path, environment):
    """Kill -9 after the first packing; the file reads, and a second run adds the rest."""
    out, library = tmp_path / "g.h5", [packing]
    for index in range(5):
        library.append(tmp_path / f"jaxmd{index}.h5")
        jax_md(index).write(library[-1])
    arguments = ["moduli", *map(str, library), "--omega", "1e-8:1e2:300", "-o", str(out)]
    command = [sys.executable, "-m", "petscjam", *arguments]
    run = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=environment)
    while not out.exists():
        assert run.poll() is None
    run.kill()
    run.wait()
    assert 1 <= len(pj.read_moduli(out)) < len(library)
    assert main([*arguments, "--resume"]) == 0
    assert len(pj.read_moduli(out)) == len(library)


def test_an_input_is_never_the_output(packing, tmp_path, capfd):
    before = packing.read_bytes()
    link = tmp_path / "link.h5"
    link.symlink_to(packing)
    for verb, output in (("moduli", packing), ("export", link), ("import", packing), ("plot", packing)):
        capfd.readouterr()
        assert main([verb, str(packing), "-o", str(output), "--overwrite"]) == 2
        assert packing.read_bytes() == before


@pytest.mark.parametrize("output", ["none/g.h5", "."])
def test_an_output_that_cannot_be_written_is_refused_before_the_work(packing, tmp_path, capfd, monkeypatch, output):
    from petscjam.response.problem import LinearProblem

    monkeypatch.setattr(LinearProblem, "__init__", lambda *a, **k: pytest.fail("worked in vain"))
    monkeypatch.chdir(tmp_path)
    capfd.readouterr()
    assert "folder" in refused(capfd, "moduli", packing, "-o", output)


def test_seeds_need_a_folder(packing, capfd):
    capfd.readouterr()
    assert packing.name in refused(capfd, "prepare", "--particles", 16, "--seeds", "1:2", "-o", packing)


def test_prepare_does_not_resume_another_packing(tmp_path, capfd):
    out = tmp_path / "p.h5"
    main(["prepare", "--particles", "16", "--pressure", "1e-2", "-o", str(out)])
    capfd.readouterr()
    assert "pressure = 0.01" in refused(capfd, "prepare", "--particles", 16, "--pressure", 2e-2, "--resume", "-o", out)


def test_results_among_the_packings_are_not_packings(packing, tmp_path):
    out = tmp_path / "g.h5"
    for _ in range(2):
        assert main(["moduli", str(tmp_path), "--omega", "1", "--resume", "-o", str(out)]) == 0
    assert len(pj.read_moduli(out)) == 1


@pytest.mark.parametrize("spoil", [truncated, other_schema])
@pytest.mark.parametrize("verb", ["plot", "info"])
def test_bad_results(packing, tmp_path, capfd, spoil, verb):
    out = tmp_path / "g.h5"
    main(["moduli", str(packing), "--omega", "1,2", "-o", str(out)])
    spoil(out)
    capfd.readouterr()
    assert out.name in refused(capfd, verb, out)


def test_a_figure_of_unknown_kind(packing, tmp_path, capfd):
    out = tmp_path / "g.h5"
    main(["moduli", str(packing), "--omega", "1,2", "-o", str(out)])
    capfd.readouterr()
    assert "'xyzzy'" in refused(capfd, "plot", out, "-o", tmp_path / "g.xyzzy")


def test_the_figure_flags_an_unstable_packing():
    from dataclasses import replace

    from matplotlib.figure import Figure

    from petscjam.plots.modulus import _draw_moduli

    g = pj.complex_modulus(pj.import_packing(SIXTEEN), [0.1, 1.0])
    flags = {}
    for name, result in (("good", g), ("bad", replace(g, G0=-0.1)), ("saddle", replace(g, negative_modes=3))):
        axes = Figure().subplots()
        _draw_moduli(axes, {"p": result})
        flags[name] = [text.get_text() for text in axes.texts if "UNSTABLE" in text.get_text()]
    assert flags == {"good": [], "bad": ["UNSTABLE: G0 < 0"], "saddle": ["UNSTABLE: 3 negative modes"]}


def test_frequencies_in_any_order(packing, tmp_path):
    """The plot sorts them; the file keeps the order given."""
    out = tmp_path / "g.h5"
    main(["moduli", str(packing), "--omega", "10,0.1,1", "-o", str(out)])
    assert pj.read_modulus(out).omega.tolist() == [10.0, 0.1, 1.0]
    assert main(["plot", str(out)]) == 0


def test_another_solver_behind_the_prefix(packing, tmp_path, environment):
    """PETSc's own LU instead of MUMPS, without touching the code."""
    out, options = tmp_path / "g.h5", []
    for prefix in ("petscjam_", "petscjam_static_", "petscjam_follow_"):
        options += [f"-{prefix}pc_type", "lu", f"-{prefix}pc_factor_mat_solver_type", "petsc"]
    arguments = ["moduli", packing, "--omega", "0.1,1", "-o", out, "--", *options]
    run = subprocess.run([sys.executable, "-m", "petscjam", *arguments], env=environment, timeout=120)
    assert run.returncode == 0
    expected = pj.complex_modulus(pj.Packing.read(packing), [0.1, 1.0])
    assert pj.read_modulus(out).values == pytest.approx(expected.values, rel=1e-10)
    assert pj.read_modulus(out).eta0 == pytest.approx(expected.eta0, rel=1e-10)


def test_a_petsc_option_that_nobody_reads_is_named(packing, tmp_path, environment):
    arguments = ["moduli", packing, "--omega", "1", "-o", tmp_path / "g.h5", "--", "-petscjam_nonsense", "1"]
    run = subprocess.run(
        [sys.executable, "-m", "petscjam", *arguments], capture_output=True, text=True, env=environment, timeout=120
    )
    assert "-petscjam_nonsense" in run.stdout + run.stderr


# --- spectra


@pytest.fixture
def modulus(packing, tmp_path):
    main(["moduli", str(packing), "-o", str(tmp_path / "g.h5")])
    return tmp_path / "g.h5"


def test_moduli_meet_rtol_with_few_factorisations(modulus):
    g = pj.read_modulus(modulus)
    assert g.errors.max() <= 1.1e-6
    assert g.performance["factorisations"] < 15
    assert len(g.omega) == 61


def test_a_looser_rtol_takes_fewer_factorisations(packing, modulus, tmp_path):
    main(["moduli", str(packing), "--rtol", "1e-1", "-o", str(tmp_path / "loose.h5")])
    count = [pj.read_modulus(file).performance["factorisations"] for file in (tmp_path / "loose.h5", modulus)]
    assert count[0] < count[1]


def test_a_model_in_a_file_answers_without_the_packing(packing, modulus):
    s = pj.read_spectrum(modulus)
    omega = np.geomspace(2e-8, 50, 7)
    exact = pj.complex_modulus(pj.Packing.read(packing), omega).values
    assert (abs(s(omega) / exact - 1) <= s.error(omega) + 1e-10).all()


def test_fields_of_the_model_are_those_of_the_solves(packing, tmp_path):
    for name, how in (("model", ["--rtol", "1e-10"]), ("direct", ["--direct"])):
        out = str(tmp_path / f"{name}.h5")
        main(["moduli", str(packing), "--omega", "0.1,1", "--fields", "0.1,1", *how, "-o", out])
    ours, theirs = (pj.read_modulus(tmp_path / f"{name}.h5") for name in ("model", "direct"))
    assert np.allclose(ours.fields, theirs.fields, atol=1e-5, equal_nan=True)
    assert ours.geometry.checksum == theirs.geometry.checksum


def test_a_factor_out_of_core_changes_nothing_but_rounding(packing, modulus, tmp_path):
    main(["moduli", str(packing), "--out-of-core", "-o", str(tmp_path / "other.h5")])
    ours, theirs = pj.read_modulus(modulus), pj.read_modulus(tmp_path / "other.h5")
    assert np.allclose(ours.values, theirs.values, rtol=1e-10)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--rtol", "0"], "rtol"),
        (["--team-size", "0"], "team-size"),
        (["--beta", "1,x"], "beta"),
        (["--block-low-rank", "2"], "block-low-rank"),
        (["--direct", "--out-of-core"], "--direct"),
        (["--omega", "1e-100:1e100:5"], "decades"),
    ],
)
def test_bad_settings_of_spectra_are_named(packing, tmp_path, capfd, options, named):
    assert names(refused(capfd, "moduli", packing, "-o", tmp_path / "g.h5", *options), named)


@pytest.mark.parametrize("fmt", ["csv", "tts", "gt"])
def test_a_modulus_is_exported_as_text(modulus, capsys, fmt):
    assert main(["export", str(modulus), "--to", fmt]) == 0
    lines = modulus.with_suffix(f".{fmt}").read_text().splitlines()
    numbers = [line for line in lines if line[0].isdigit()]
    assert len(numbers) > 60
    assert "sixteen" in lines[0]


def test_export_on_another_grid(modulus, tmp_path):
    out = tmp_path / "g.csv"
    assert main(["export", str(modulus), "--omega", "1e-3:1:4", "-o", str(out)]) == 0
    omega = [float(line.split(",")[0]) for line in out.read_text().splitlines() if line[0].isdigit()]
    assert np.allclose(omega, [1e-3, 1e-2, 1e-1, 1.0])


def test_export_of_several_results_asks_which(packing, tmp_path, capfd):
    out = tmp_path / "g.h5"
    main(["moduli", str(packing), "--prestress-both", "--omega", "1,2", "-o", str(out)])
    capfd.readouterr()
    message = refused_lines(capfd, "export", out, "--to", "tts")
    assert "without pre-stress" in message
    name = next(name for name in pj.read_moduli(out) if "without" in name)
    assert main(["export", str(out), "--group", name]) == 0


def test_formats_of_packings_are_not_those_of_moduli(packing, modulus, capfd):
    assert "csv" in refused(capfd, "export", modulus, "--to", "xyz")
    assert "xyz" in refused(capfd, "export", packing, "--to", "tts")
    assert "--omega" in refused(capfd, "export", packing, "--omega", "1")
    assert "--time" in refused(capfd, "export", modulus, "--average", "--time", "1")


def test_a_model_is_drawn(packing, tmp_path):
    pj.write_spectrum(pj.spectrum(pj.Packing.read(packing)), tmp_path / "model.h5")
    assert main(["plot", str(tmp_path / "model.h5")]) == 0
    assert main(["info", str(tmp_path / "model.h5")]) == 0
    assert (tmp_path / "model.png").stat().st_size > 20_000


def refused_lines(capfd, *arguments):
    assert main([str(argument) for argument in arguments]) == 2
    return capfd.readouterr().err

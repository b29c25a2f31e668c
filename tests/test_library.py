"""Libraries of packings: the same files for any number of ranks and after any kill; clear refusals."""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from itertools import chain

import numpy as np
import pytest
from helpers import contents, names, refused

import petscjam as pj
import petscjam.plots
from petscjam.base.errors import InputError, SolverError
from petscjam.cli import main
from petscjam.parallel.teams import cores_each, teams
from petscjam.plots.tables import describe_library
from petscjam.preparation.library import INDEX, RECIPE, threads_for

SMALL = dict(particles=[8, 16], pressures=[1e-2, 1e-3], seeds=[1, 2])
FAMILY = dict(particles=[16], pressures=[1e-3, 1e-1, 1e-2], seeds=[3], decompress=True)


@pytest.fixture
def shared(comm, tmp_path):
    """One new folder for all ranks."""
    return comm.bcast(tmp_path)


@pytest.fixture
def folder(tmp_path):
    """A library of three packings."""
    pj.prepare_library(tmp_path / "lib", [16], [1e-2], [1, 2, 3])
    return tmp_path / "lib"


# --- teams ------------------------------------------------------------------------------------------------


@pytest.mark.parallel(nprocs=[1, 2, 3])
@pytest.mark.parametrize("size", [1, 2])
def test_every_task_is_dealt_once(comm, size):
    with teams(comm, size) as team:
        mine = team.deal([3, 1, 4, 1.5, 9], lambda task: task) if team.comm.rank == 0 else []
    assert sorted(chain(*comm.allgather(mine))) == [1, 1.5, 3, 4, 9]


@pytest.mark.parallel(nprocs=3)
def test_teams_have_so_many_ranks_and_the_last_the_rest(comm):
    with teams(comm, 2) as team:
        assert comm.allgather(team.comm.size) == [2, 2, 1]
        assert comm.allgather((team.index, team.count)) == [(0, 2), (0, 2), (1, 2)]


def test_the_most_costly_task_comes_first(comm):
    with teams(comm) as team:
        assert team.deal(["b", "ccc", "a", "dd"], len) == ["ccc", "dd", "b", "a"]


def test_a_team_of_nobody_is_refused(comm):
    with pytest.raises(InputError, match="not 0"), teams(comm, 0):
        pass


@pytest.mark.parallel(nprocs=[1, 2])
def test_threads_are_for_few_large_packings(comm, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2, 3})
    assert threads_for([20_000], comm) == {1: 4, 2: 2}[comm.size]
    assert threads_for([20_000] * (comm.size + 1), comm) == 1
    assert threads_for([64], comm) == 1


@pytest.mark.parallel(nprocs=2)
@pytest.mark.parametrize(
    ("affinities", "each"),
    [([{0, 1, 2, 3}] * 2, 2), ([{0, 1}, {2, 3}], 2), ([{0}, {1}], 1), ([{5}, {5}], 1), ([{0, 1}, {1, 2}], 1)],
)
def test_the_cores_of_a_rank(comm, monkeypatch, affinities, each):
    """Whether the ranks may run anywhere or are bound."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: affinities[comm.rank])
    assert cores_each(comm) == each


# --- what a library holds ---------------------------------------------------------------------------------


@pytest.mark.parallel(nprocs=[1, 2, 3])
def test_packings_do_not_depend_on_the_number_of_ranks(comm, shared):
    library = pj.prepare_library(shared / "lib", **SMALL, comm=comm)
    assert len(library.rows) == 8
    if comm.rank == 0:
        for row in library.rows:
            alone = pj.prepare_packing(row["particles"], row["target"], row["seed"])
            alone.write(shared / "alone.h5", overwrite=True)
            assert (shared / "lib" / row["file"]).read_bytes() == (shared / "alone.h5").read_bytes()


@pytest.mark.parallel(nprocs=[1, 3])
def test_more_ranks_than_packings(comm, shared):
    library = pj.prepare_library(shared / "lib", [8], [1e-2], [1], comm=comm)
    assert [row["file"] for row in library.rows] == ["N8_p0.01_s0001.h5"]


@pytest.mark.parallel(nprocs=[1, 2])
def test_a_family_is_decompressed_from_the_highest_pressure(comm, shared):
    library = pj.prepare_library(shared / "lib", **FAMILY, comm=comm)
    packing = pj.prepare_packing(16, 1e-1, 3)
    for pressure in (1e-1, 1e-2, 1e-3):
        packing = pj.relax_packing(packing, pressure) if pressure < 1e-1 else packing
        there = pj.Packing.read(shared / "lib" / f"N16_p{pressure:g}_s0003.h5")
        assert there.checksum == packing.checksum
        assert there.provenance["decompressed_from"] == [p for p in (1e-1, 1e-2, 1e-3) if p > pressure]
    assert [row["target"] for row in library.rows] == [1e-3, 1e-2, 1e-1]


def test_lower_pressures_of_a_family_are_less_dense(tmp_path):
    phi = [row["phi"] for row in pj.prepare_library(tmp_path / "lib", **FAMILY).rows]
    assert phi == sorted(phi)


def test_rows_are_what_the_packings_say(folder):
    rows = pj.read_library(folder).rows
    assert [row["seed"] for row in rows] == [1, 2, 3]
    for row in rows:
        packing = pj.Packing.read(folder / row["file"])
        certificate = packing.certificate
        for name in ("Z", "rattlers", "contacts", "lowest_eigenvalue", "shear_modulus", "proved", "pressure"):
            assert row[name] == getattr(certificate, name), name
        assert (row["phi"], row["checksum"]) == (packing.phi, packing.checksum)
        assert row["seconds"] > 0


def test_rows_of_packings_from_elsewhere(folder, capsys):
    """One that is not jammed is not judged; a target, or a seed, is a number or none."""
    given = pj.Packing.read(folder / "N16_p0.01_s0001.h5")
    said = {"pressure": "0.001", "seed": "7", "program": "other"}
    loose = pj.Packing(2 * given.positions, given.radii, pj.Box(2 * given.box.cell), provenance=said)
    loose.write(folder / "loose.h5")
    row = pj.read_library(folder).rows[-1]
    assert (row["file"], row["target"], row["seed"]) == ("loose.h5", None, None)
    assert (row["potential"], row["pressure"], row["contacts"], row["proved"]) == ("harmonic", 0, 0, None)
    assert main(["info", str(folder)]) == 0
    assert "3 proved minima, 0 not proved, 1 not judged" in capsys.readouterr().out
    assert main(["plot", str(folder)]) == 0
    pj.prepare_library(folder, [16], [1e-2], [1, 2, 3, 4], resume=True)
    assert len(pj.read_library(folder).rows) == 5


def test_disks_on_one_point_are_named(folder):
    pj.Packing([[1, 1], [1, 1]], [0.5, 0.5], pj.Box.square(4.0)).write(folder / "z.h5")
    with pytest.raises(InputError, match=f"^{folder}/z.h5: .*same point"):
        pj.read_library(folder)


def test_files_keep_no_time(folder, tmp_path):
    time.sleep(1.1)  # HDF5 would count seconds
    pj.prepare_library(tmp_path / "later", [16], [1e-2], [1, 2, 3])
    assert contents(tmp_path / "later", "*.h5") == contents(folder, "*.h5")


def test_the_table_counts_and_averages(tmp_path):
    library = pj.prepare_library(tmp_path / "lib", [16], [1e-2, 1e-3], [1, 2, 3])
    first, _, _, dense, loose, _ = describe_library(library).splitlines()
    assert first.startswith("6 packings: 6 proved minima, 0 not proved, 0 not judged; 0 failed")
    for line, target in ((dense, 1e-2), (loose, 1e-3)):
        some = [row for row in library.rows if row["target"] == target]
        phi = [row["phi"] for row in some]
        words = line.split()
        assert words[:5] == ["16", f"{target:g}", "3", "3", "0"]
        assert float(words[5]) == pytest.approx(np.mean(phi), abs=1e-6)
        assert float(words[7]) == pytest.approx(np.std(phi, ddof=1) / 3**0.5, abs=1e-6)
        assert int(words[10]) == sum(row["shear_modulus"] < 0 for row in some)


# --- resume -----------------------------------------------------------------------------------------------


def test_resume_makes_what_is_missing_and_nothing_else(folder, capfd):
    before = contents(folder, "*.h5")
    (folder / "N16_p0.01_s0002.h5").unlink()
    library = pj.prepare_library(folder, [16], [1e-2], [1, 2, 3], resume=True)
    assert library.tried == {"N16_p0.01_s0002.h5"}
    assert contents(folder, "*.h5") == before


def test_a_family_with_gaps_resumes_to_the_same_bits(tmp_path):
    folder = tmp_path / "lib"
    pj.prepare_library(folder, **FAMILY)
    before = contents(folder, "*.h5")
    for gone in (["0.1"], ["0.01"], ["0.01", "0.001"], ["0.1", "0.001"]):
        for pressure in gone:
            (folder / f"N16_p{pressure}_s0003.h5").unlink()
        pj.prepare_library(folder, **FAMILY, resume=True)
        assert contents(folder, "*.h5") == before, gone


def test_existing_packings_are_refused_without_resume(folder):
    before = contents(folder, "*.h5")
    with pytest.raises(InputError, match=r"N16_p0\.01_s0001\.h5: exists already"):
        pj.prepare_library(folder, [16], [1e-2], [1, 4])
    assert contents(folder, "*.h5") == before


def test_overwrite_makes_all_again(folder):
    (folder / "N16_p0.01_s0002.h5").write_bytes((folder / "N16_p0.01_s0001.h5").read_bytes())
    library = pj.prepare_library(folder, [16], [1e-2], [1, 2, 3], overwrite=True)
    assert [row["seed"] for row in library.rows] == [1, 2, 3]


def test_a_packing_under_another_name_is_not_resumed(folder):
    (folder / "N16_p0.01_s0002.h5").write_bytes((folder / "N16_p0.01_s0001.h5").read_bytes())
    with pytest.raises(InputError, match="has seed = 1, not 2"):
        pj.prepare_library(folder, [16], [1e-2], [1, 2, 3], resume=True)


def test_a_family_cannot_get_a_pressure_in_between(tmp_path):
    pj.prepare_library(tmp_path / "lib", **FAMILY)
    pj.prepare_library(tmp_path / "lib", [16], [1e-1, 1e-2, 1e-3, 1e-4], [3], decompress=True, resume=True)
    with pytest.raises(InputError, match=r"decompressed_from = \[0.1\]"):
        pj.prepare_library(tmp_path / "lib", [16], [1e-1, 5e-2, 1e-2], [3], decompress=True, resume=True)


@pytest.mark.parametrize("decompress", [False, True])
def test_a_larger_range_extends_a_library(tmp_path, decompress):
    """Pressures differ by rounding, and are the same."""
    folder, series = tmp_path / "lib", dict(particles=[8], seeds=[1], decompress=decompress)
    pj.prepare_library(folder, pressures=np.geomspace(1e-1, 1e-2, 4), **series)
    more = np.geomspace(1e-1, 1e-3, 7) * (1 + 1e-15)
    library = pj.prepare_library(folder, pressures=more, **series, resume=True)
    assert (len(library.tried), len(library.rows)) == (3, 7)


def test_leftovers_of_a_killed_run_are_cleared(folder):
    (folder / "N16_p0.01_s0001.h5").rename(folder / ".N16_p0.01_s0001.h5.123.part")
    pj.prepare_library(folder, [16], [1e-2], [1, 2, 3], resume=True)
    assert not list(folder.glob(".*"))


# --- the index --------------------------------------------------------------------------------------------


def lines(folder):
    return (folder / INDEX).read_text().splitlines()


def torn(index):
    index.write_bytes(index.read_bytes()[:-30])


def foreign(index):
    index.write_text(index.read_text() + "\0\0,not,a line\nN16_p9_s0001.h5," + 15 * "x," + "bad\n")


def another(index):
    checksum = pj.Packing.read(index.parent / "N16_p0.01_s0003.h5").checksum
    index.write_text(index.read_text().replace(checksum, "0123456789abcdef"))


@pytest.mark.parametrize("spoil", [torn, foreign, another, os.unlink])
def test_a_spoilt_index_is_mended(folder, spoil):
    before = [line.rsplit(",", 2)[0] for line in lines(folder)]
    spoil(folder / INDEX)
    pj.prepare_library(folder, [16], [1e-2], [1, 2, 3], resume=True)
    assert sorted(line.rsplit(",", 2)[0] for line in lines(folder)) == sorted(before)


def test_only_the_times_of_lost_lines_are_lost(folder):
    torn(folder / INDEX)
    assert [row["seconds"] is None for row in pj.read_library(folder).rows].count(True) == 1


def test_a_packing_that_is_gone_has_no_line(folder):
    (folder / "N16_p0.01_s0003.h5").unlink()
    pj.prepare_library(folder, [16], [1e-2], [1, 2], resume=True)
    assert len(lines(folder)) == 1 + 2


# --- refusals ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [("ratio", 1.5), ("shear_stabilised", True), ("decompress", True), ("potential_name", "hertzian")],
)
def test_another_recipe_is_refused(folder, name, value):
    before = contents(folder)
    with pytest.raises(InputError, match=f"{folder}: has packings with {name} = .*, not {value}"):
        pj.prepare_library(folder, [16], [1e-2], [4], resume=True, **{name: value})
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (dict(radii=np.full(16, 1.2)), "the mean diameter of .* is 1, that of z.h5 2.4"),
        (dict(potential_name="hertzian"), "the potential of .* is harmonic, that of z.h5 hertzian"),
    ],
)
@pytest.mark.parametrize("by_hand", [False, True])
def test_mixed_units_are_refused(folder, other, message, by_hand):
    given = pj.Packing.read(folder / "N16_p0.01_s0001.h5")
    settings = dict(radii=given.radii, box=given.box) | other
    pj.Packing(given.positions, **settings).write(folder / "z.h5")
    if by_hand:
        (folder / RECIPE).unlink()
    with pytest.raises(InputError, match=message):
        pj.read_library(folder)
    with pytest.raises(InputError, match=message):
        pj.prepare_library(folder, [16], [1e-2], [4])


def test_polydisperse_disks_are_not_mixed_units(tmp_path):
    library = pj.prepare_library(tmp_path / "lib", [8, 9], [1e-2], range(1, 6), polydispersity=0.3)
    assert len(library.rows) == 10


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (dict(particles=[16, 1]), "not 1"),
        (dict(pressures=[1e-2, -1.0]), "-1"),
        (dict(seeds=[-2]), "-2"),
        (dict(ratio=0.0), "ratio"),
        (dict(pressures=[1e-2, 1e-12]), "1e-12"),
        (dict(budget=0), "not 0"),
        (dict(pressures=[1e-2, 0.01]), "N16_p0.01_s0001.h5"),
        (dict(seeds=[]), "nothing to prepare"),
        (dict(pressures=[1e-2, np.nan]), "nan"),
        (dict(method="magic"), "magic"),
    ],
)
@pytest.mark.parallel(nprocs=[1, 2])
def test_bad_input_is_refused_before_anything_is_made(comm, shared, bad, message):
    arguments = dict(particles=[16], pressures=[1e-2], seeds=[1]) | bad
    with pytest.raises(InputError, match=message):
        pj.prepare_library(shared / "lib", **arguments, comm=comm)
    assert not (shared / "lib").exists()


@pytest.mark.parametrize("text", ["", "{}", '{"schema": 99, "recipe": {}}', "[1]"])
def test_a_recipe_that_makes_no_sense(folder, text):
    (folder / RECIPE).write_text(text)
    with pytest.raises(InputError, match=RECIPE):
        pj.prepare_library(folder, [16], [1e-2], [4])


def test_a_damaged_packing_is_named(folder):
    file = folder / "N16_p0.01_s0002.h5"
    file.write_bytes(file.read_bytes()[:-500])
    with pytest.raises(InputError, match=file.name):
        pj.prepare_library(folder, [16], [1e-2], [1, 2, 3], resume=True)


def test_a_folder_without_packings(tmp_path, capfd):
    assert "no packings" in refused(capfd, "info", tmp_path)
    assert "no packings" in refused(capfd, "plot", tmp_path)
    assert "nowhere" in refused(capfd, "info", tmp_path / "nowhere")


# --- failures ---------------------------------------------------------------------------------------------


@pytest.mark.parallel(nprocs=[1, 2])
def test_a_packing_beyond_the_budget_does_not_stop_the_others(comm, shared):
    series = dict(particles=[16], pressures=[1e-1, 1e-4], seeds=[1, 2], comm=comm)
    library = pj.prepare_library(shared / "lib", **series, budget=400)
    assert {row["target"] for row in library.rows} == {1e-1}
    assert [(row["target"], row["seed"]) for row in library.failed] == [(1e-4, 1), (1e-4, 2)]
    assert all("400" in row["failure"] for row in library.failed)
    library = pj.prepare_library(shared / "lib", **series, resume=True)
    assert (len(library.rows), library.failed) == (4, [])


def test_a_family_ends_where_it_fails(tmp_path):
    library = pj.prepare_library(tmp_path / "lib", [16], [1e-1, 1e-4, 1e-5], [1], decompress=True, budget=300)
    assert [row["target"] for row in library.rows] == [1e-1]
    assert "N16_p0.0001_s0001.h5, to start from, failed" in [row["failure"] for row in library.failed]


def test_a_family_goes_on_from_what_is_there(tmp_path, monkeypatch):
    pressures = [1e-1, 1e-2, 1e-3, 1e-4]
    folder, series = tmp_path / "lib", dict(particles=[16], seeds=[3], decompress=True, resume=True)
    pj.prepare_library(folder, pressures=pressures[:3], **series)
    (folder / "N16_p0.01_s0003.h5").unlink()

    def relax(packing, pressure, **options):
        if pressure == 1e-2:
            raise SolverError("injected")
        return pj.relax_packing(packing, pressure, **options)

    monkeypatch.setattr("petscjam.preparation.library.relax_packing", relax)
    library = pj.prepare_library(folder, pressures=pressures, **series)
    assert [(row["target"], row["failure"]) for row in library.failed] == [(1e-2, "injected")]
    assert [row["target"] for row in library.rows] == [1e-4, 1e-3, 1e-1]


@pytest.mark.parallel(nprocs=[1, 2])
def test_any_exception_in_making_a_packing_is_a_failure(comm, shared, monkeypatch):
    def prepare(n, pressure, seed, **options):
        if seed == 2:
            raise ZeroDivisionError("injected")
        return pj.prepare_packing(n, pressure, seed, **options)

    monkeypatch.setattr("petscjam.preparation.library.prepare_packing", prepare)
    library = pj.prepare_library(shared / "lib", [16], [1e-2], [1, 2, 3], comm=comm)
    assert [row["failure"] for row in library.failed] == ["ZeroDivisionError: injected"]
    assert len(library.rows) == 2


@pytest.mark.parallel(nprocs=2)
@pytest.mark.parametrize("what", ["petscjam.preparation.library._append", "petscjam.Packing.write"])
@pytest.mark.parametrize(("error", "elsewhere"), [(InputError, InputError), (MemoryError, RuntimeError)])
def test_a_file_that_one_rank_cannot_write_ends_all(comm, shared, monkeypatch, what, error, elsewhere):
    def full(*arguments, **options):
        raise error("disk full")

    if comm.rank == 1:
        monkeypatch.setattr(what, full)
    with pytest.raises(error if comm.rank == 1 else elsewhere, match="disk full"):
        pj.prepare_library(shared / "lib", **SMALL, comm=comm)


def test_a_packing_that_is_not_there_has_failed(tmp_path, monkeypatch, capfd):
    """Whether or not its line got into the index."""
    monkeypatch.setattr("petscjam.preparation.library._append", lambda *arguments: None)
    arguments = ["prepare", "--particles", "16", "--pressure", "1e-1,1e-4", "--budget", "400"]
    assert main([*arguments, "-o", str(tmp_path / "lib")]) == 1
    printed = capfd.readouterr()
    assert "1 prepared, 0 there already, 1 failed" in printed.out
    assert "N16_p0.0001_s0001.h5: unknown" in printed.err


def test_failures_are_listed_and_the_status_is_1(tmp_path, capfd):
    out = tmp_path / "lib"
    arguments = ["prepare", "--particles", "16", "--pressure", "1e-1,1e-4", "--budget", "400", "-o", str(out)]
    assert main(arguments) == 1
    printed = capfd.readouterr()
    assert "1 prepared, 0 there already, 1 failed" in printed.out
    assert "N16_p0.0001_s0001.h5: " in printed.err
    main(["info", str(out)])
    assert "1 failed" in capfd.readouterr().out
    assert main([*arguments[:5], *arguments[7:], "--resume"]) == 0
    assert len(contents(out, "*.h5")) == 2


# --- the command ------------------------------------------------------------------------------------------


def test_sizes_pressures_and_seeds_on_the_command_line(tmp_path):
    out = tmp_path / "lib"
    arguments = ["--particles", "8,10", "--pressure", "1e-1:1e-3:3", "--seeds", "4:5", "--method", "cg"]
    assert main(["prepare", *arguments, "--shear-stabilised", "-o", str(out)]) == 0
    library = pj.read_library(out)
    assert {(row["particles"], row["target"], row["seed"]) for row in library.rows} == {
        (n, p, seed) for n in (8, 10) for p in (1e-1, 1e-2, 1e-3) for seed in (4, 5)
    }
    assert (library.recipe["method"], library.recipe["shear_stabilised"]) == ("cg", True)


CONFIG = """
particles = [8, 16]
pressure = "1e-1:1e-2:2"
seeds = [1, 3]
decompress = true
potential = "hertzian"
polydispersity = 0.05
output = "OUT"
"""


@pytest.fixture
def config(tmp_path):
    (tmp_path / "lib.toml").write_text(CONFIG.replace("OUT", str(tmp_path / "lib")))
    return tmp_path / "lib.toml"


def test_a_file_of_settings(tmp_path, config):
    assert main(["prepare", "--config", str(config)]) == 0
    library = pj.read_library(tmp_path / "lib")
    assert {(r["particles"], r["target"], r["seed"]) for r in library.rows} == {
        (n, p, seed) for n in (8, 16) for p in (1e-1, 1e-2) for seed in (1, 3)
    }
    expected = {"decompress": True, "potential_name": "hertzian", "polydispersity": 0.05}
    assert {name: library.recipe[name] for name in expected} == expected


def test_the_command_line_counts_more_than_the_file(tmp_path, config):
    line = ["--seed", "7", "--particles=8", "--pressure", "1e-2", "-o", str(tmp_path / "other")]
    assert main(["prepare", *line, "--config", str(config)]) == 0
    assert [r["file"] for r in pj.read_library(tmp_path / "other").rows] == ["N8_p0.01_s0007.h5"]
    assert not (tmp_path / "lib").exists()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("presure = 1e-3", "pressure"),
        ("pressure = -1.0", "-1"),
        ("decompress = 1", "decompress"),
        ("pressure 1e-3", "lib.toml"),
        ("seed = 1\nseeds = [1]", "--seed"),
        ("config = 'x'", "config"),
        ("particles = 16.5", "16.5"),
        ("[prepare]\nseed = 1", "prepare"),
    ],
)
def test_bad_settings(tmp_path, config, capfd, text, named):
    config.write_text(text)
    assert names(refused(capfd, "prepare", "--config", config, "-o", tmp_path / "lib"), named)


def test_no_file_of_settings(tmp_path, capfd):
    assert "none.toml" in refused(capfd, "prepare", "-o", tmp_path / "lib", "--config", "none.toml")
    assert "--config" in refused(capfd, "prepare", "-o", tmp_path / "lib", "--config")


def test_a_folder_is_drawn(folder):
    assert main(["plot", str(folder)]) == 0
    assert folder.with_name("lib.png").read_bytes().startswith(b"\x89PNG")


def test_a_packing_is_drawn(folder, tmp_path):
    assert main(["plot", str(folder / "N16_p0.01_s0001.h5"), "-o", str(tmp_path / "p.png")]) == 0
    petscjam.plots.plot_packing(pj.Packing.read(folder / "N16_p0.01_s0001.h5"), tmp_path / "q.png")
    assert (tmp_path / "p.png").read_bytes() == (tmp_path / "q.png").read_bytes()


def test_results_in_the_folder_do_no_harm(folder, capsys):
    out = folder / "g.h5"
    assert main(["moduli", str(folder), "--omega", "1", "-o", str(out)]) == 0
    assert len(pj.read_moduli(out)) == 3
    main(["info", str(folder)])
    assert "3 packings" in capsys.readouterr().out


# --- kill -9 ----------------------------------------------------------------------------------------------


def processes(session):
    """Ids of the processes of a session: mpirun puts its ranks into process groups of their own."""
    found = []
    for name in os.listdir("/proc"):
        with suppress(ValueError, ProcessLookupError):
            if os.getsid(int(name)) == session:
                found.append(int(name))
    return found


def kill(run):
    """Kill -9 a run with all its ranks, and wait until they are gone."""
    while alive := [p for p in processes(run.pid) if p != run.pid or run.poll() is None]:
        for process in alive:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        run.poll()
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("kills", "ranks"), [(3, 1), pytest.param(20, 2, marks=[pytest.mark.slow, pytest.mark.timeout(900)])]
)
def test_killed_at_random_moments_it_ends_with_the_same_files(tmp_path, environment, launch, kills, ranks):
    seeds = range(1, 3 * kills * ranks)
    settings = ["--particles", "64", "--pressure", "1e-1,1e-3", "--decompress", "--seeds", f"1:{len(seeds)}"]
    pj.prepare_library(tmp_path / "undisturbed", [64], [1e-1, 1e-3], seeds, decompress=True)
    expected, out = contents(tmp_path / "undisturbed", "*.h5"), tmp_path / "lib"
    command = [sys.executable, "-m", "petscjam", "prepare", *settings, "--resume", "-o", str(out)]
    if ranks > 1:
        command = [*launch(ranks), *command]
    moment, killed = random.Random(1), 0
    for _ in range(kills):
        before = len(contents(out, "*.h5"))
        run = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        early = moment.random() < 0.25  # while it starts
        more, last = moment.choice([1, 2, 3]), time.monotonic() + (moment.uniform(0, 1.5) if early else 60)
        while run.poll() is None and len(contents(out, "*.h5")) < before + more and time.monotonic() < last:
            time.sleep(0.001)
        time.sleep(moment.uniform(0, 0.03))
        killed += run.poll() is None
        kill(run)
        assert before <= len(contents(out, "*.h5")) < len(expected)
        assert all(data == expected[name] for name, data in contents(out, "*.h5").items())
    assert killed == kills
    subprocess.run(command, env=environment, check=True, capture_output=True, timeout=300)
    assert contents(out, "*.h5") == expected
    assert not list(out.glob(".*"))
    assert len(lines(out)) == 1 + len(expected)

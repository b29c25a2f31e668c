"""The figures of the paper, made from a few small packings: pictures, pages, what is kept and refused."""

import csv
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import names, refused
from mpi4py import MPI
from test_shear import StoppedError, stop_at
from test_shear_plots import DENSE, DILUTE, FAST, SHARE, SLOW, synthetic_run, two_bands

import petscjam as pj
from petscjam.analysis.mode_sum import modes_needed
from petscjam.analysis.scaling import Curve, collapse, power_law
from petscjam.analysis.statistics import by_pressure
from petscjam.base.errors import InputError, SolverError
from petscjam.cli import main
from petscjam.figures import FIGURES, SETS, Request, make_figure, module_of, presets
from petscjam.figures.data import FigureData
from petscjam.figures.flows import Flows
from petscjam.figures.modes import WITHIN
from petscjam.figures.page import Page
from petscjam.figures.panels import draw_mean, guide
from petscjam.figures.parameters import Parameters
from petscjam.io.jobs import PackingAnalysis
from petscjam.io.results import read_results
from petscjam.md.grid import Point
from petscjam.parallel.comm import on_root
from petscjam.parallel.petsc import start

RUNS = Path(__file__).parents[1] / "mpi_runs"
COMMON = {"particles": 64, "pressure": "1e-2:1e-3:2", "seeds": "1:3"}
OMEGA = {"omega": "1e-5:1e1:13"}
TINY = {
    "bt1": {**COMMON, **OMEGA, "pressure": "1e-3:1e-3:1", "fields": [1e-5, 1e-3, 10.0]},
    "bt2": {**COMMON, "seeds": "1:1"},
    "bt3": {**COMMON, **OMEGA},
    "bt4": {**COMMON, **OMEGA, "beta_pressure": 0.01, "betas": "1e-3:1e1:4"},
    "bt5": COMMON,
    "bt6": {**COMMON, **OMEGA, "fluid_pressure": 0.01, "fluids": "1e-2:1e2:3"},
    "bt7": {
        **COMMON,
        **OMEGA,
        "sizes": [64, 128],
        "contact_pressure": "1e-2:1e-2:1",
        "contact_omega": "1e-3:1e1:2",
        "shown_pressure": 1e-2,
        "widths": [0.5],
    },
    "bt8": {**COMMON, "particles": [64, 128], "large": 128, "large_pressure": "1e-2:1e-3:2"},
    "modes": {**COMMON, "count": 126, "moments": 64},
    "drag": {**COMMON, "alphas": [0.5], "stress": 1e-3, "omega": "1e-5:1e1:7", "linear_omega": "1e-6:1e7:14"},
    "softening": {**COMMON, "seeds": "1:4", "span": 2.0, "parts": [0.1, 0.2]},
    "nonlinear-drag": {
        **COMMON,
        "alphas": [0.5],
        "stress": 1e-3,
        "X": "1e-4:1e0:5",
        "points": 8,
        "linear_omega": "1e-6:1e3:10",
    },
}
FLOWS = {
    "particles": 64,
    "phi": [0.7, 0.82],
    "Q": "1:200:4",
    "rate": 1e-3,
    "rates": [3e-3, 1e-2],
    "details": [0.7, 0.82],
    "seeds": "1:2",
    "strain": 0.1,
    "budget": 0.2,
    "goal": 0.2,
    "rounds": 1,
}
LARGE = {
    "particles": 128,
    "phi": [0.7, 0.76, 0.78, 0.8, 0.81, 0.84],
    "rates": [1e-2, 3e-2],
    "seeds": "1:1",
    "strain": 0.1,
    "budget": 0.2,
    "goal": 0.2,
    "phi_bagnoldian": 0.77,
    "phi_newtonian": 0.82,
    "rate_ratio": 5.0,
    "start_rate": 3e-2,
    "threshold": 10.0,
    "pressure": 3e-3,
    "contour_phi": [0.78, 0.8],
    "contour_rate": [1e-2, 1e-2],
    "smaller": 64,
    "size_rates": [1e-2],
    "ramp_phi": 0.8,
    "ramp_rates": [1e-2, 3e-2],
    "ramp_from": 1e-2,
    "ramp_to": 1e-1,
    "kappas": [1e-2, 2e-2],
    "ramps": 2,
}
KINDS = {"vot_cd": FLOWS, "vot_cd_rot": FLOWS | {"Q_details": [1.0, 200.0]}, "vot_large": LARGE}
TINY |= {name: KINDS[of] for name, of in SETS.items()}
figures = pytest.mark.parametrize("name", FIGURES)


def write(path, parameters):
    """Write parameters as the preset ``tiny``."""
    lines = [f'{key} = "{x}"' if isinstance(x, str) else f"{key} = {x}" for key, x in parameters.items()]
    path.write_text("\n".join(["[tiny]", *lines, ""]))
    return path


def make(name, folder, *, parameters=None, **options):
    """Make a figure by itself, without a log."""
    file = write(folder / f"{name}.toml", parameters or TINY[name])
    return make_figure(Request(name, "tiny", folder, file, **options), comm=MPI.COMM_SELF, log=lambda line: None)


def figure_data(parameters, folder, comm, **options):
    return FigureData(Parameters("bt5", "tiny", parameters), folder, comm, **options)


@pytest.fixture(scope="module", autouse=True)
def few_resamples():
    """Let an error bar come from 20 resamples: these take most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("bt3", "bt8"):
            patch.setattr(f"petscjam.figures.{name}.collapse", partial(collapse, resamples=20))
        yield


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """Return the folder of all figures that one process makes."""
    return tmp_path_factory.mktemp("figures")


@pytest.fixture(scope="module")
def made(shared):
    """Make each figure once, for all tests."""
    cache = {}

    def get(name):
        if name not in cache:
            cache[name] = make(name, shared, overwrite=True)
        return cache[name]

    return get


@pytest.fixture
def page():
    return Page()


@pytest.fixture
def packings(made, shared, tmp_path):
    """Return a folder with the packings of 64 disks at p = 0.01, and nothing else."""
    made("bt5")
    (tmp_path / "packings").mkdir()
    for file in shared.glob("packings/N64_p0.01_s*.h5"):
        shutil.copy(file, tmp_path / "packings")
    return tmp_path


@pytest.fixture
def blind(monkeypatch):
    """Draw nothing where the picture is not looked at: it takes most of the time."""
    monkeypatch.setattr("petscjam.figures.bt5.save", lambda figure, path: None)
    monkeypatch.setattr("petscjam.figures.bt6.draw_collapse", lambda *arguments: None)


def state(folder, pattern="*.h5"):
    return {file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.glob(pattern)}


def results_of(name, folder):
    return {file.name: file for file in [*folder.glob(f"{name}.h5"), *folder.glob(f"{name}-*.h5")]}


def table(text):
    """Return the rows of the first table of a page."""
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in text.splitlines() if line[:1] == "|"]
    first = [row[0] for row in rows].index("parameter")
    return rows[2:first], dict(row for row in rows[first + 2 :])


# --- every figure


@figures
def test_a_picture_and_a_page(made, shared, name):
    from PIL import Image

    findings = made(name)
    for picture in [shared / f"{name}.png", *shared.glob(f"{name}-*.png")]:
        assert np.asarray(Image.open(picture).convert("L")).std() > 5  # not blank
    rows, parameters = table((shared / f"{name}.md").read_text())
    assert [row[0] for row in rows] == [f.name for f in findings]
    assert parameters == {key: str(value) for key, value in TINY[name].items()}


@figures
def test_what_is_found_is_a_number_or_says_why_not(made, name):
    findings = made(name)
    assert all(np.isfinite(f.value) or f.remark for f in findings)
    if name not in SETS:
        assert name == "bt2" or any(np.isfinite(f.value) and np.isfinite(f.error) for f in findings)


@pytest.mark.parametrize("name", SETS)
def test_the_table_has_the_numbers_of_the_picture(made, shared, name):
    findings = made(name)
    head, *rows = csv.reader((shared / f"{name}.csv").open(encoding="utf-8"))
    assert head == ["quantity", "x", "value", "error", "paper"]
    assert [row[0] for row in rows[: len(findings)]] == [f.name for f in findings]
    drawn = [row for row in rows if row[1]]
    assert len(drawn) > 3 or name in ("vot3", "vot17", "vot21", "vot25", "vot26", "vot29", "vot35")
    assert sum(np.isfinite(float(row[2])) for row in drawn) >= 0.9 * len(drawn)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("bt3", "bt6"))) for name in FIGURES]
)
def test_resume_redraws_and_solves_nothing_again(made, shared, name):
    findings = made(name)
    before, page = state(shared), (shared / f"{name}.md").read_bytes()
    packings = state(shared / "packings")
    (shared / f"{name}.png").unlink()
    assert str(make(name, shared, resume=True)) == str(findings)
    assert (shared / f"{name}.png").exists()
    assert (shared / f"{name}.md").read_bytes() == page
    assert state(shared) == before
    assert state(shared / "packings") == packings


@figures
def test_a_picture_that_exists_is_kept(made, shared, name):
    made(name)
    before = state(shared, f"{name}.*")
    with pytest.raises(InputError, match=rf"{name}\.png.*exists"):
        make(name, shared)
    assert {key: value for key, value in state(shared, f"{name}.*").items() if key[-5:] != ".toml"} == {
        key: value for key, value in before.items() if key[-5:] != ".toml"
    }


@figures
@pytest.mark.parametrize("preset", ["small", "medium", "paper"])
def test_a_preset_holds_what_the_figure_asks_for(made, shared, name, preset):
    made(name)
    assert "does not know" not in (shared / f"{name}.md").read_text()
    parameters = presets(name)[preset]
    assert set(parameters) == set(TINY[name])  # which is all that is asked for; nothing else is known
    known = Parameters(name, preset, parameters)
    assert known["seeds"][0] == 1
    for key in set(parameters) - {"seeds"}:
        assert (known.points(key) > 0).all()


@figures
def test_presets_are_small_medium_and_paper(name):
    assert list(presets(name)) == ["small", "medium", "paper"]


def test_the_files_of_the_package_are_those_of_mpi_runs():
    ours = {file.name: file.read_bytes() for file in (RUNS.parent / "src/petscjam/figures").glob("*.toml")}
    assert set(ours) == {f"{module_of(name)}.toml" for name in FIGURES}
    assert ours == {name: (RUNS / name).read_bytes() for name in ours}


ONE_OF_EACH = [
    name for name in FIGURES if name not in SETS or name == min(SETS, key=lambda other: SETS[other] != SETS[name])
]


@pytest.mark.parametrize(("name", "key"), [(name, key) for name in ONE_OF_EACH for key in TINY[name]])
def test_a_missing_parameter_is_named(made, shared, name, key, blind):
    made(name)
    less = {other: value for other, value in TINY[name].items() if other != key}
    with pytest.raises(InputError, match=rf"{name}: the preset tiny lacks {key}"):
        make(name, shared, parameters=less, resume=True)


def test_a_parameter_that_is_not_known_is_named(packings, blind):
    with pytest.raises(pj.InputError, match="unknown sedes"):
        make("bt5", packings, parameters={**COMMON, "sedes": "1:3"}, existing=True)


# --- one packing, and it is unstable


def make_unstable(name, folder):
    """Make a figure of the one packing of 64 disks with G0 < 0 with pre-stress."""
    files = (folder / "packings").glob("*.h5")
    seed = next(file.stem[-1] for file in files if pj.viscosity(pj.Packing.read(file)).G0 <= 0)
    changed = {"particles": 64, "pressure": 1e-2, "seeds": f"{seed}:{seed}"}
    if name == "bt7":
        changed["sizes"] = [64]
    make(name, folder, parameters={**TINY[name], **changed}, existing=True)


@pytest.mark.parametrize("name", ["bt1", "bt4", "bt6", "bt7"])
def test_a_panel_without_stable_packings_is_an_error(packings, name):
    with pytest.raises(SolverError, match=f"{name}: .* none of . results is stable"):
        make_unstable(name, packings)


@pytest.mark.parametrize("name", ["bt3", "bt5", "bt8"])
def test_what_is_left_without_prestress_is_drawn(packings, name):
    make_unstable(name, packings)
    assert (packings / f"{name}.png").exists()
    assert "with pre-stress: 1 of 1." in (packings / f"{name}.md").read_text()


# --- large systems


def test_a_figure_stopped_and_resumed_has_the_same_numbers(made, shared, tmp_path):
    """Stopped five times: in steady runs and in ramps."""
    made("vot31")
    request = Request("vot31", "tiny", tmp_path, write(tmp_path / "vot31.toml", TINY["vot31"]))
    for stop in (0.02, 0.1, 0.3, 0.6, 0.9):
        with pytest.raises(StoppedError):
            make_figure(request, comm=MPI.COMM_SELF, progress=stop_at(stop), log=lambda line: None)
        assert not (tmp_path / "vot31.csv").exists()
    make_figure(request, comm=MPI.COMM_SELF, log=lambda line: None)
    assert (tmp_path / "vot31.csv").read_bytes() == (shared / "vot31.csv").read_bytes()


@pytest.mark.parametrize("existing", [False, True])
def test_a_figure_reads_each_of_its_runs_once(made, shared, monkeypatch, existing):
    """A search and the panels ask for the same runs."""
    made("vot17")
    files = []
    monkeypatch.setattr("petscjam.figures.flows.read", lambda file: files.append(file) or pj.md.read(file))
    make("vot17", shared, resume=True, existing=existing)
    assert files and len(files) == len(set(files))


# --- large systems, with bands that nobody computed


@pytest.fixture
def banded(monkeypatch, tmp_path):
    """Make a figure of runs with two bands: P ~ γ̇; a random start is homogeneous."""

    def made_up(flows, points):
        vx, phi, mean = two_bands()
        for k, point in enumerate(points):
            homogeneous = type(point) is Point
            fields = (None, None) if homogeneous else (vx, phi)
            run = synthetic_run(*fields, noise=3e-5, seed=k, rate=mean)
            rows = {name: run.rows[name] * point.rate / mean for name in run.rows if name[-3:] in ("_xx", "_xy", "_yy")}
            Rv = np.full(len(run.time), 1.0 if homogeneous else 100.0)
            flows.runs[point] = replace(run, rows={**run.rows, **rows, "dvx2": Rv, "vy2": np.ones_like(Rv)})

    monkeypatch.setattr(Flows, "make", made_up)
    monkeypatch.setattr(Flows, "tally", "")
    few = LARGE | {"phi": [0.7, 0.76, 0.78, 0.84], "rates": [1e-2], "contour_phi": [0.78], "contour_rate": [1e-2]}

    def get(name):
        found = {f.name: f for f in make(name, tmp_path, parameters=few, overwrite=True)}
        return found, (tmp_path / f"{name}.csv").read_text()

    return get


def test_both_bands_on_the_page(banded):
    for name in ("vot27", "vot28"):
        found, _ = banded(name)
        for quantity, value in (("φB*", DILUTE), ("φN*", DENSE), ("γ̇B*", FAST), ("γ̇N*", SLOW), ("f′, from γ̇", SHARE)):
            one = found[f"{quantity} at φ = 0.78, γ̇ = 0.01"]
            assert abs(one.value - value) < max(5 * one.error, 0.02 * value)


def test_the_lever_rule(banded):
    found, _ = banded("vot34")
    one = next(f for name, f in found.items() if name.startswith("f′φB* + (1 − f′)φN* at φ = 0.78, γ̇ = 0.01"))
    assert one.value == pytest.approx(SHARE * DILUTE + (1 - SHARE) * DENSE, abs=4e-4)
    assert 0 < one.error < 1e-3


def test_the_states_of_the_bands_in_the_diagrams(banded):
    for name, x in (("vot25", "φ"), ("vot26", "P"), ("vot29", "Σ"), ("vot35", "φ")):
        found, text = banded(name)
        assert f"{x}B* from bands, two-phase start" in text
        assert "from bands, random start" not in text
        end = found["P at the critical end point, from φN* − φB*"]
        assert np.isnan(end.value)  # a single run with bands
        assert "not determined" in end.remark


def test_boundaries_from_Rv_enclose_the_banded_runs(banded):
    found, _ = banded("vot24")
    assert found["φB at γ̇ = 0.01 from Rv, two-phase start"].value == pytest.approx(0.77)
    assert found["φN at γ̇ = 0.01 from Rv, two-phase start"].value == pytest.approx(0.81)
    assert np.isnan(found["φB and φN at γ̇ = 0.01 from Rv, random start"].value)


# --- the command


def command(folder, name="bt5", parameters=None):
    file = write(folder / "parameters.toml", parameters or TINY[name])
    return ["figure", name, "--preset", "tiny", "--parameters", file, "-o", folder]


def test_the_command_prints_the_page(packings, capsys):
    parameters = {**COMMON, "pressure": "1e-2:1e-2:1"}
    assert main([str(a) for a in command(packings, parameters=parameters)]) == 0
    out = capsys.readouterr().out
    assert (packings / "bt5.md").read_text() in out
    assert out.splitlines()[-1] == str(packings / "bt5.png")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["bt9"], "bt9"),
        (["bt3", "--preset", "huge"], "huge"),
        (["bt3", "--parameters", "gone.toml"], "gone.toml"),
        (["bt3", "--resume", "--overwrite"], "--resume"),
        (["bt3", "--present", "small"], "--preset"),
    ],
)
def test_what_is_unknown_is_named(tmp_path, capfd, arguments, named):
    assert named in refused(capfd, "figure", *arguments, "-o", tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"pressure": "fast"}, "pressure"),
        ({"pressure": "1e-2:1e-3"}, "1e-2:1e-3"),
        ({"seeds": "3:1"}, "seeds"),
        ({"particles": 3}, "3"),
        ({"pressure": "-1:1:3"}, "pressure"),
    ],
)
def test_a_bad_value_is_named(tmp_path, capfd, changed, named):
    assert names(refused(capfd, *command(tmp_path, parameters={**COMMON, **changed})), named)


def test_parameters_that_are_not_toml(tmp_path, capfd):
    arguments = command(tmp_path)
    (tmp_path / "parameters.toml").write_text("[tiny\n")
    message = refused(capfd, *arguments)
    assert "parameters.toml" in message
    assert "TOML" in message


def test_existing_prepares_nothing(packings, blind):
    before = state(packings / "packings", "*")
    make("bt5", packings, existing=True)
    assert state(packings / "packings", "*") == before
    page = (packings / "bt5.md").read_text()
    assert "- 3 packings: N = 64; p = 0.01, 0.001; 3 seeds." in page
    assert "Left out because not there or not proved minima: 3." in page


def test_existing_without_packings_is_refused(tmp_path, capfd):
    message = refused(capfd, *command(tmp_path), "--existing")
    assert str(tmp_path / "packings") in message


def test_overwrite_solves_again_and_keeps_packings(packings, blind):
    parameters = {**COMMON, "pressure": "1e-2:1e-2:1"}
    make("bt5", packings, parameters=parameters)
    results, prepared = state(packings), state(packings / "packings")
    make("bt5", packings, parameters=parameters, overwrite=True)
    assert state(packings)["bt5.h5"][1] > results["bt5.h5"][1]
    assert state(packings / "packings") == prepared


# --- which packings


def test_other_packings_of_the_file_are_not_mixed_in(packings, blind):
    one = {**COMMON, "pressure": "1e-2:1e-2:1"}
    make("bt5", packings, parameters=one)
    make("bt5", packings, parameters={**one, "seeds": "2:3"}, resume=True)
    assert len(read_results(packings / "bt5.h5")) == 6
    assert "- 2 packings: " in (packings / "bt5.md").read_text()


def test_a_packing_that_took_the_place_of_another_is_not_mixed_with_it(packings, comm, blind):
    one = {**COMMON, "pressure": "1e-2:1e-2:1", "seeds": "1:2"}
    make("bt5", packings, parameters=one, existing=True)
    other = pj.Packing.read(packings / "packings" / "N64_p0.01_s0003.h5")
    other.write(packings / "packings" / "N64_p0.01_s0002.h5", overwrite=True)
    (packings / "packings" / "index.csv").unlink(missing_ok=True)
    data = figure_data(one, packings, comm, existing=True)
    files = [packings / "packings" / "N64_p0.01_s0002.h5"]
    data.checksums[files[0]] = other.checksum
    found = data.results(files, PackingAnalysis(pj.quasistatic_response), prestress=(True, False))
    assert [r.origin.checksum for r in found.values()] == [other.checksum] * 2
    assert len(read_results(packings / "bt5.h5")) == 6


def test_unstable_packings_are_counted(made, shared):
    made("bt5")
    files = sorted(shared.glob("packings/N64_p0.01_*.h5"))[:3]
    lost = sum(pj.quasistatic_response(pj.Packing.read(file)).shear_modulus <= 0 for file in files)
    assert lost > 0
    line = next(line for line in (shared / "bt5.md").read_text().splitlines() if "unstable" in line)
    assert f"N = 64, p = 0.01, with pre-stress: {lost} of 3" in line
    assert "without pre-stress" not in line  # there K is positive


def tide(packing, *, name, **options):
    """Fail for one packing."""
    if name == "N64_p0.01_s0002":
        raise SolverError("the tide was high")
    return pj.quasistatic_response(packing, name=name, **options)


def test_a_result_that_failed_is_told(packings, monkeypatch, blind):
    monkeypatch.setattr("petscjam.figures.bt5.quasistatic_response", tide)
    make("bt5", packings, existing=True)
    assert "2 results failed: the tide was high; the tide was high" in (packings / "bt5.md").read_text()


def test_a_result_that_fails_again_does_not_stop_the_figure(packings, comm):
    data = figure_data({"seeds": "1:3"}, packings, comm, existing=True)
    files = data.packings(64, [1e-2])
    for _ in range(2):
        assert len(data.results(files, PackingAnalysis(tide))) == 2


# --- ranks


@pytest.mark.parallel(nprocs=2)
def test_two_ranks_find_the_same(tmp_path, comm):
    start(comm)
    folder, alone = (comm.bcast(tmp_path / name) for name in ("two", "one"))
    on_root(comm, folder.mkdir)
    file = on_root(comm, write, folder / "bt5.toml", COMMON)
    make_figure(Request("bt5", "tiny", folder, file), comm=comm, log=lambda line: None)
    on_root(comm, shutil.copytree, folder / "packings", alone / "packings")
    on_root(comm, make, "bt5", alone)
    assert (folder / "bt5.png").exists()
    ours, theirs = (read_results(path / "bt5.h5") for path in (folder, alone))
    assert ours.keys() == theirs.keys()
    for name, r in ours.items():
        assert r.shear_modulus == pytest.approx(theirs[name].shear_modulus, rel=1e-12)
    # but for the first line, the command: it names the file of parameters
    pages = [(path / "bt5.md").read_text().split("\n", 1)[1] for path in (folder, alone)]
    assert pages[0] == pages[1]


@pytest.mark.parallel(nprocs=2)
def test_two_ranks_make_the_same_runs(tmp_path, comm):
    folder, alone = (comm.bcast(tmp_path / name) for name in ("two", "one"))
    for path in (folder, alone):
        on_root(comm, path.mkdir)
    few = LARGE | {"phi": [0.76, 0.8], "rates": [3e-2], "contour_phi": [0.8], "contour_rate": [1e-2]}
    for name in ("vot31", "vot34"):
        file = on_root(comm, write, folder / f"{name}.toml", few)
        make_figure(Request(name, "tiny", folder, file), comm=comm, log=lambda line: None)
        on_root(comm, partial(make, name, alone, parameters=few))
        assert (folder / f"{name}.csv").read_bytes() == (alone / f"{name}.csv").read_bytes()


@pytest.mark.parallel(nprocs=2)
def test_an_error_in_a_drawing_is_that_of_all_ranks(tmp_path, comm, monkeypatch):
    def full(*arguments):
        raise InputError("no room")

    monkeypatch.setattr("petscjam.figures.vot.save", full)
    folder = comm.bcast(tmp_path)
    file = on_root(comm, write, folder / "vot9.toml", TINY["vot9"])
    with pytest.raises(InputError, match="no room"):
        make_figure(Request("vot9", "tiny", folder, file), comm=comm, log=lambda line: None)


@pytest.mark.parallel(nprocs=2)
def test_every_rank_knows_what_was_found(tmp_path, comm):
    start(comm)
    folder = comm.bcast(tmp_path)
    file = on_root(comm, write, folder / "bt5.toml", {**COMMON, "pressure": "1e-2:1e-2:1"})
    found = make_figure(Request("bt5", "tiny", folder, file), comm=comm, log=lambda line: None)
    assert len(found) > 0
    assert str(found) == comm.bcast(str(found))


@pytest.mark.parallel(nprocs=2)
def test_an_unknown_preset_is_said_on_every_rank(tmp_path, comm):
    with pytest.raises(InputError, match="huge"):
        make_figure(Request("bt5", "huge", comm.bcast(tmp_path)), comm=comm)


# --- the numbers on the page


def test_an_exponent_of_exact_power_laws(page):
    p = np.array([1e-2, 1e-3, 1e-4])
    samples = [2 * x**0.37 * np.array([0.9, 1.0, 1.1]) for x in p]
    fit = page.exponent("y", p, samples, "1/3")
    (found,) = page.findings
    assert found.value == pytest.approx(0.37, rel=1e-12)
    assert 0 < found.error < 0.1
    assert (found.name, found.paper, fit.prefactor) == ("y", "1/3", pytest.approx(2, rel=1e-10))


def test_an_exponent_takes_no_pressure_with_one_packing(page):
    p = np.array([1e-1, 1e-2, 1e-3])
    samples = [[1e9], *(x**-0.5 * np.array([0.9, 1.1]) for x in p[1:])]
    assert page.exponent("y", p, samples, "").exponent == pytest.approx(-0.5, rel=1e-12)


def test_an_exponent_in_a_window(page):
    p = np.array([1e-1, 1e-2, 1e-3, 1e-4])
    samples = [np.array([0.9, 1.1]) * (x**0.5 if x < 0.02 else 7.0) for x in p]
    page.exponent("y", p, samples, "", (1e-4, 0.011))
    assert page.findings[0].value == pytest.approx(0.5, rel=1e-12)
    assert "x from 0.0001 to 0.01" in page.findings[0].remark


@pytest.mark.parametrize("samples", [[], [[1.0, 2.0]], [[1.0, 2.0], [3.0]], [[1.0, -2.0], [1.0, 3.0]]])
def test_an_exponent_that_cannot_be_fitted_says_why(page, samples):
    assert page.exponent("y", np.array([1e-3, 1e-2])[: len(samples)], samples, "1/2") is None
    (found,) = page.findings
    assert np.isnan([found.value, found.error]).all()
    assert "power law" in found.remark


def test_a_collapse_notes_every_exponent(page):
    x = np.geomspace(1e-3, 1e3, 30)
    spread = np.array([0.95, 1.0, 1.05])[:, None]
    curves = [Curve(x * n**1.5, spread * n**0.5 * (x / (1 + x)), {"n": n}) for n in (1.0, 4.0, 16.0)]

    def form(a, b, *, n):
        return n**-b, n**-a

    page.collapse("c", lambda: collapse(curves, form, {"a": 0.4, "b": 1.4}, resamples=5), {"a": "1", "b": "2"})
    assert {f.name: f.paper for f in page.findings} == {"c: a": "1", "c: b": "2"}
    assert [f.value for f in page.findings] == pytest.approx([0.5, 1.5], abs=0.02)


def test_a_collapse_that_fails_says_why(page):
    assert page.collapse("c", lambda: collapse([], lambda: (1, 1), {}), {"a": "1"}) is None
    assert np.isnan(page.findings[0].value)
    assert page.findings[0].remark


def test_the_page_rounds_and_leaves_gaps(page):
    page.exponent("good", [1e-2, 1e-3], [[1.0, 1.1], [0.1, 0.11]], "1")
    page.exponent("bad", [1e-2], [[1.0, 1.1]], "1")
    rows, _ = table(page.text("petscjam figure", COMMON))
    assert rows[0][:2] == ["good", f"1 ± {page.findings[0].error:.1g}"]
    assert rows[1][:2] == ["bad", "—"]


def test_the_page_has_the_digits_above_the_error(page):
    page.found("φ", 0.80523, 3e-4, "0.8090")
    page.found("P", 2.98765e-5, 2e-6, "")
    rows, _ = table(page.text("petscjam figure", COMMON))
    assert [row[1] for row in rows] == ["0.8052 ± 0.0003", "2.99e-05 ± 2e-06"]


def test_groups_by_pressure(made, shared):
    made("bt5")
    results = read_results(shared / "bt5.h5")
    groups = by_pressure(results.values(), prestress=False)
    assert list(groups) == [1e-3, 1e-2]
    assert [len(some) for some in groups.values()] == [3, 3]
    assert not any(r.prestress for some in groups.values() for r in some)


@pytest.mark.parametrize("prestress", [True, False])
def test_the_viscosity_is_linear_in_beta(made, shared, prestress):
    """What β* of Fig. 4 rests on."""
    made("bt5")
    packing = pj.Packing.read(shared / "packings" / "N64_p0.001_s0001.h5")
    none, some, full = (
        pj.viscosity(packing, damping=pj.ContactDamping(beta), prestress=prestress).eta0 for beta in (0.0, 0.3, 1.0)
    )
    assert full > 2 * none
    assert some == pytest.approx(0.7 * none + 0.3 * full, rel=1e-9)


def test_the_crossover_of_beta_is_where_both_parts_are_equal(made, shared):
    findings = made("bt4")
    p, samples = np.array([1e-3, 1e-2]), []
    for x in p:
        stars = []
        for seed in (1, 2, 3):
            packing = pj.Packing.read(shared / "packings" / f"N64_p{x:g}_s000{seed}.h5")
            a, b = (pj.viscosity(packing, damping=pj.ContactDamping(beta), prestress=False).eta0 for beta in (0.2, 0.7))
            slope = (b - a) / 0.5
            stars.append((a - 0.2 * slope) / slope)
        samples.append(stars)
    expected = power_law(p, samples)
    found = next(f for f in findings if f.name == "β* ~ p^x, without pre-stress")
    assert found.value == pytest.approx(expected.exponent, rel=1e-7)
    assert found.error == pytest.approx(expected.error, rel=1e-5)


def test_slopes_of_the_critical_regime(made, shared):
    """Fig. 1 against a straight line by hand."""
    findings = made("bt1")
    slopes = []
    for g in read_results(shared / "bt1.h5").values():
        middle = (g.omega > 3e-3 * (1 + 1e-6)) & (g.omega < 0.1)
        x, y = np.log(g.omega[middle]), np.log(g.values.real[middle])
        slopes.append(((x - x.mean()) * (y - y.mean())).sum() / ((x - x.mean()) ** 2).sum())
    found = next(f for f in findings if f.name == "G′ ~ ω^Δ")
    assert found.value == pytest.approx(np.mean(slopes), rel=1e-10)
    assert found.error == pytest.approx(np.std(slopes, ddof=1) / 3**0.5, rel=1e-10)


def test_all_modes_rebuild_the_response(made, shared):
    made("modes")
    for r in read_results(shared / "modes-rebuilt.h5").values():
        assert r.counts[-1] == r.modes
        assert r.ratios[:, -1] == pytest.approx(1, abs=1e-8)
        assert abs(r.ratios[:, 0] - 1).max() > 0.01


# --- pieces


@pytest.mark.parametrize(
    ("ratios", "least"),
    [
        ([1.0, 1.0, 1.0, 1.0], 1),
        ([3.0, 1.0, 1.0, 1.0], 2),
        ([1.0, 0.5, 1.0, 1.0], 4),
        ([3.0, 2.0, 1 + 0.99 * WITHIN, 1.0], 4),
        ([0.0, 0.0, 1 - 1.01 * WITHIN, 1.0], 8),
        ([3.0, 2.0, 2.0, 2.0], np.nan),
        ([1.0, 1.0, 1.0, 2.0], np.nan),
    ],
)
def test_how_many_modes_are_enough(ratios, least):
    assert modes_needed(ratios, [1, 2, 4, 8], WITHIN) == pytest.approx(least, nan_ok=True)


@pytest.fixture
def axes():
    from matplotlib.figure import Figure

    return Figure().subplots()


def test_means_are_drawn_rescaled_and_cut(made, shared, axes):
    made("bt3")
    some = by_pressure(read_results(shared / "bt3.h5").values(), prestress=False)[1e-3]
    draw_mean(axes, some, "k", "p", x=1e3, y=2.0, most=0.1)
    storage, loss = axes.lines
    kept = some[0].omega <= 0.1
    values = np.array([g.values[kept] for g in some])
    assert storage.get_xdata() == pytest.approx(1e3 * some[0].omega[kept])
    assert storage.get_ydata() == pytest.approx(2 * values.real.sum(0) / 3)
    assert loss.get_ydata() == pytest.approx(2 * values.imag.sum(0) / 3)
    upper = axes.collections[0].get_paths()[0].vertices[:, 1].max()
    top = 2 * (values.real.mean(0) + values.real.std(0, ddof=1) / 3**0.5)
    assert upper == pytest.approx(top.max())


def test_a_guide_has_the_slope_it_says(axes):
    guide(axes, (1e-4, 1e-2), 3.0, 0.5, "slope ½")
    x, y = axes.lines[0].get_data()
    assert y == pytest.approx([3, 30])
    assert list(x) == [1e-4, 1e-2]

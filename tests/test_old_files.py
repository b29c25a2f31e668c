"""Files of earlier versions (tests/fixtures/formats) are read: every number that was written comes back."""

import json
import math
import shutil
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers import contents

import petscjam as pj
from petscjam.cli import main
from petscjam.md.settings import Settings
from petscjam.rows.damping import DampingLaw

pytestmark = pytest.mark.parallel(nprocs=1)
FORMATS = Path(__file__).parent / "fixtures" / "formats"
SLOW, FAST = (f"flows/CD_rot-N24-phi0.8-Q1-rate{rate}-seed1" for rate in ("0.01", "0.03"))
PACKINGS = """
packing.h5 unjudged.h5 hertzian.h5 ramp.quenched.h5 library/N16_p0.01_s0001.h5 library/N24_p0.01_s0001.h5
figures/packings/N16_p0.01_s0001.h5 figures/packings/N16_p0.01_s0002.h5 older/library/N16_p0.01_s0001.h5
"""
FOREIGN = f"exported.xyz exported.gsd {SLOW}.frames/frame_000001.xyz {FAST}.frames/frame_000001.xyz"
LIBRARIES = "library figures/packings older/library"
MODULI = "moduli.h5 stokes.h5 direct.h5 stokes-direct.h5 older/moduli.h5"
DRAWN = "nonaffine.h5 viscosity.h5 modes.h5 relaxations.h5 correlations.h5 drag.h5 aqs.h5 amplitudes.h5 step-strain.h5"
DRAWN += " figures/modes-density.h5"
RESULTS = f"{MODULI} {DRAWN} drag-uniform.h5 quench.h5 figures/modes-rebuilt.h5"
RUNS = f"{SLOW}.h5 {FAST}.h5 steps.h5 oscillation.h5 ramp.h5 older/run.h5"
FEWER = "fewer/run.h5"  # SLOW without the rows GONE
GONE = "parts", "rebuilds", "spin_variance", "normal2", "tangential2"
READERS = {
    **dict.fromkeys(PACKINGS.split(), pj.Packing.read),
    **dict.fromkeys(FOREIGN.split(), pj.import_packing),
    **dict.fromkeys(LIBRARIES.split(), pj.read_library),
    **dict.fromkeys(RESULTS.split(), pj.read_results),
    "spectrum.h5": pj.read_spectrum,
    **dict.fromkeys(RUNS.split(), pj.md.read),
}
BESIDE = {f"{library}/{name}" for library in LIBRARIES.split() for name in ("library.json", "index.csv")}
OTHER = {"modes.toml", "figures/modes.md", "expected.json", "make.py", FEWER, *BESIDE}
# Of every kind that has a picture
PICTURES = f"""
packing.h5 hertzian.h5 exported.xyz exported.gsd {SLOW}.frames/frame_000001.xyz library moduli.h5 stokes.h5
{DRAWN} spectrum.h5 flows oscillation.h5 ramp.h5 older/library older/run.h5
"""
OMEGA = [1e-3, 0.3, 20.0]
SERIES = """
strain time rate contacts pressure_elastic stress_elastic pressure stress friction viscosity bagnold banding
"""


def numbers(value):
    """What a file holds, as JSON: of an array its shape, ends and exact sum."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Settings):
        value = value.attributes
    if is_dataclass(value):
        return {item.name: numbers(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {key: numbers(inside) for key, inside in value.items()}
    if isinstance(value, np.ndarray) and value.ndim:
        if value.dtype.kind == "c":
            value = np.stack([value.real, value.imag], -1)
        flat = value.ravel().tolist()
        ends = [flat[0], flat[-1]] if flat else []
        return {"shape": value.shape, "ends": ends, "sum": math.fsum(flat)}
    if isinstance(value, list | tuple | frozenset):
        return [numbers(inside) for inside in value]
    return value.item() if isinstance(value, np.generic | np.ndarray) else value


def derived(value):
    """Numbers that are computed from those of the file."""
    if isinstance(value, pj.md.Run):
        with np.errstate(divide="ignore"):  # at rest
            return {name: getattr(value, name).tolist() for name in SERIES.split()}
    if isinstance(value, pj.Spectrum):
        g = value(OMEGA)
        return {"real": g.real.tolist(), "imaginary": g.imag.tolist(), "G(1)": float(value.G(1.0))}
    return {}


def described(folder):
    """The table expected.json of the files in ``folder``."""
    read = {file: reader(folder / file) for file, reader in READERS.items()}
    read[FEWER] = read[f"{SLOW}.h5"]
    table = {file: {"stored": numbers(value), "derived": derived(value)} for file, value in read.items()}
    for name in GONE:
        del table[FEWER]["stored"]["rows"][name]
    return table


EXPECTED = json.loads((FORMATS / "expected.json").read_text()) if (FORMATS / "expected.json").exists() else {}


RENAMED = {"packing": "origin"}


def compare(value, expected, where):
    """Look up every name of ``expected`` in ``value``; there may be more."""
    if isinstance(value, Settings):
        value = value.attributes
    if isinstance(expected, dict) and not (isinstance(value, np.ndarray) and value.ndim):
        for name, inside in expected.items():
            there = value[name] if isinstance(value, Mapping) else getattr(value, RENAMED.get(name, name))
            compare(there, inside, f"{where}.{name}")
    elif isinstance(expected, list) and any(isinstance(inside, dict) for inside in expected):
        assert len(value) == len(expected), where
        for k, inside in enumerate(expected):
            compare(value[k], inside, f"{where}[{k}]")
    else:
        value = str(value) if isinstance(value, DampingLaw) and isinstance(expected, str) else value  # it was text once
        assert json.dumps(numbers(value)) == json.dumps(expected), where  # NaN is NaN


def check(file, value):
    compare(value, EXPECTED[file]["stored"], file)
    found = derived(value)
    for name, expected in EXPECTED[file]["derived"].items():
        assert found[name] == pytest.approx(expected, rel=1e-12), f"{file}: {name}"


@pytest.fixture
def there(request):
    """The path of a fixture; the test is skipped if its format needs a package that is not installed."""
    if request.param.endswith(".gsd"):
        pytest.importorskip("gsd")
    return FORMATS / request.param


def test_every_file_is_there_and_is_read():
    files = {str(path.relative_to(FORMATS)) for path in FORMATS.rglob("*") if path.is_file()}
    files = {name for name in files if "__pycache__" not in name}
    assert files == {name for name in READERS if name not in LIBRARIES.split()} | OTHER
    assert set(EXPECTED) == {*READERS, FEWER}


@pytest.mark.parametrize("there", READERS, indirect=True)
def test_every_number_comes_back(there):
    file = str(there.relative_to(FORMATS))
    value = READERS[file](there)
    check(file, value)
    if file in MODULI.split():
        compare(pj.read_moduli(there), EXPECTED[file]["stored"], file)
    if file in MODULI.split() and len(value) == 1:
        (name,) = value
        compare(pj.read_modulus(there), EXPECTED[file]["stored"][name], file)


@pytest.mark.parametrize("file", ["stokes.h5", "older/moduli.h5"])
def test_the_reduced_model_comes_out_of_a_file_of_moduli(file):
    (expected,) = EXPECTED[file]["stored"].values()
    compare(pj.read_spectrum(FORMATS / file), expected["model"], file)


def test_a_spectrum_is_read_as_moduli():
    expected = EXPECTED["spectrum.h5"]["stored"]
    for g in (pj.read_modulus(FORMATS / "spectrum.h5"), *pj.read_results(FORMATS / "spectrum.h5").values()):
        assert (g.omega[0], g.omega[-1], len(g.omega)) == pytest.approx((*expected["span"], 61), rel=1e-12)
        compare(g.origin, expected["packing"], "packing")


def test_a_run_with_fewer_rows_is_read():
    check(FEWER, pj.md.read(FORMATS / FEWER))


# The command


@pytest.mark.parametrize("there", [*READERS, "flows"], indirect=True)
def test_info(there, capfd):
    assert main(["info", str(there)]) == 0
    out, err = capfd.readouterr()
    assert out
    assert err == ""
    file = str(there.relative_to(FORMATS))
    if file in RESULTS.split():
        for name in EXPECTED[file]["stored"]:
            assert name in out


@pytest.mark.parametrize("there", PICTURES.split(), indirect=True)
def test_plot(there, tmp_path, titles):
    assert main(["plot", str(there), "-o", str(tmp_path / "figure.png")]) == 0
    assert (tmp_path / "figure.png").stat().st_size > 0
    assert titles


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A folder with copies of the files, to work in."""
    shutil.copytree(FORMATS, tmp_path / "formats")
    monkeypatch.chdir(tmp_path / "formats")


@pytest.mark.parametrize(
    "command",
    [
        "prepare --particles 16,24 --pressure 1e-2 --seed 1 -o library",
        "prepare --particles 16 --pressure 1e-2 --seeds 1:1 -o older/library",
        "moduli packing.h5 --omega 1e-4:1e2:7 --beta 0.3 --prestress-both --fields 1e-2 -o moduli.h5",
        "moduli older/library --omega 1e-4:1e2:4 -o older/moduli.h5",
        "modes packing.h5 --count 5 -o modes.h5",
        "nonlinear-drag packing.h5 --omega 1e-2:1:3 --stress 1e-4 -o drag.h5",
    ],
)
def test_work_that_is_done_is_not_done_again(copied, command):
    before = contents(Path(), "*.h5")
    assert main([*command.split(), "--resume"]) == 0
    assert contents(Path(), "*.h5") == before


def test_a_run_goes_on(copied):
    """The way is that of the same machine's uninterrupted run up to rounding."""
    command = "shear --particles 24 --phi 0.8 --row-time 10 --rate 1e-2 --strain 0.6"
    assert main([*command.split(), "--resume", "-o", f"{SLOW}.h5"]) == 0
    assert main([*command.split(), "-o", "whole.h5"]) == 0
    run, whole = pj.md.read(f"{SLOW}.h5"), pj.md.read("whole.h5")
    assert len(run.strain) == len(EXPECTED[f"{SLOW}.h5"]["derived"]["strain"]) + 1
    for name in SERIES.split():
        assert getattr(run, name) == pytest.approx(getattr(whole, name), rel=1e-6), name


def test_an_older_run_is_a_start(copied):
    command = "shear --start older/run.h5 --Q 2 --strain 0.02 --rate 1e-2 -o on.h5"
    assert main(command.split()) == 0
    older, run = pj.md.read("older/run.h5"), pj.md.read("on.h5")
    assert run.settings.strain0 == older.state.strain
    np.testing.assert_array_equal(run.state.radii, older.state.radii)


def test_a_figure_is_drawn_from_what_is_there(copied, capfd):
    before = contents(Path("figures"), "*.h5")
    command = "figure modes --parameters modes.toml --existing --resume -o figures"
    assert main(command.split()) == 0
    assert contents(Path("figures"), "*.h5") == before

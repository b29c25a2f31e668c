"""The package in a notebook, a script and an editor: names, lines of text, tables, strings where a law is meant."""

import os
import subprocess
import sys
import traceback
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
from helpers import SIXTEEN

import petscjam as pj
from petscjam.base.errors import InputError, MissingError
from petscjam.base.tables import Table, optional
from petscjam.io.kinds import recognise
from petscjam.io.results import read_results
from petscjam.plots.files import CONTENTS
from petscjam.rows.damping import LAWS

pytestmark = pytest.mark.parallel(nprocs=1)
FORMATS = Path(__file__).parent / "fixtures" / "formats"
FILES = [*sorted(FORMATS.glob("*.h5")), FORMATS / "library", FORMATS / "flows"]


def content(path):
    """What a file or folder holds: an object, or the first of several."""
    kind = recognise(path)
    found = CONTENTS[kind].read(path)
    return next(iter(found.values())) if kind in ("results", "runs") else found


@pytest.fixture(scope="module")
def packing():
    return pj.import_packing(SIXTEEN)


# Names


@pytest.mark.parametrize("module", [pj, pj.md])
def test_dir_names_everything(module):
    assert set(module.__all__) <= set(dir(module))
    assert all(getattr(module, name) is not None for name in module.__all__)


USER = """
import petscjam as pj

packing = pj.prepare_packing(n=64, pressure=1e-2, seed=1, progress=True)
model = pj.spectrum(packing, (1e-4, 1e2), damping="contact")
reveal_type(packing)
reveal_type(model)
reveal_type(pj.complex_modulus(packing, [0.1]).values)
reveal_type(pj.average([model, model]).mean)
reveal_type(pj.md.shear("CD", start=packing).mean("stress").error)
pj.spectrum(packing, "low to high")
"""


@pytest.mark.slow
def test_mypy_sees_the_types_of_a_script(tmp_path):
    (tmp_path / "user.py").write_text(USER)
    environment = {**os.environ, "MYPYPATH": str(Path(pj.__file__).parents[1])}
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--ignore-missing-imports",
        "--follow-imports=silent",
        "user.py",
    ]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    lines = done.stdout.splitlines()
    seen = [line.split('"')[1] for line in lines if "Revealed type" in line]
    assert [name.rpartition(".")[2] for name in seen[:2]] == ["Packing", "Spectrum"]
    assert "complex" in seen[2]
    assert "complex" in seen[3]
    assert seen[4].endswith("float")
    errors = [line for line in lines if ": error:" in line]
    assert len(errors) == 1
    assert "user.py:11" in errors[0]


# Lines of text and small tables


class Cells(HTMLParser):
    """The text of the cells of a table."""

    def __init__(self, text):
        super().__init__()
        self.open, self.cells = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1] in ("td", "th"):
            self.cells.append(data)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_object_is_one_line_and_a_small_table(path):
    found = content(path)
    assert repr(found).startswith(type(found).__name__ + "(")
    assert len(repr(found)) < 600
    assert "\n" not in repr(found)
    table = Cells(found._repr_html_())
    assert not table.open
    assert table.cells[::2] == list(found.facts())


def test_a_name_is_not_html(packing):
    g = pj.complex_modulus(packing, [1.0], name="<b>&")
    assert "<b>" not in g._repr_html_()
    assert "<b>&" in Cells(g._repr_html_()).cells


# Flat tables


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_object_is_a_dataframe(path):
    found = content(path)
    frame, table = found.to_dataframe(), found.flat()
    assert list(frame.columns) == list(table.columns)
    assert len(frame) == len(table) > 0
    read = pd.read_csv(BytesIO(table.to_csv()), comment="#", float_precision="round_trip")
    for name in frame.select_dtypes("number"):
        assert np.array_equal(read[name], frame[name].astype(float), equal_nan=True)  # all digits
    stored = pyarrow.parquet.read_table(BytesIO(table.to_parquet()))
    assert stored.column_names == list(frame.columns)
    for name, unit in table.units.items():
        if unit:
            assert stored.schema.field(name).metadata[b"unit"].decode() == unit


def test_a_dataframe_of_moduli_has_the_law_and_the_values():
    g = next(iter(pj.read_moduli(FORMATS / "moduli.h5").values()))
    frame = g.to_dataframe()
    assert (frame.omega == g.omega).all()
    assert (frame.G_storage + 1j * frame.G_loss == g.values).all()
    assert (frame[["beta", "pressure", "G0"]] == [0.3, g.origin.pressure, g.G0]).all(axis=None)
    assert frame.attrs["units"]["omega"] == "1/tau1"


def test_a_dataframe_has_a_line_for_each_amplitude_and_frequency():
    o = next(iter(read_results(FORMATS / "amplitudes.h5").values()))
    for line in o.to_dataframe().itertuples():
        a, w = list(o.amplitude).index(line.amplitude), list(o.omega).index(line.omega)
        assert line.values_real == o.values[a, w].real
        assert line.linear_imag == o.linear[w].imag
        assert line.fifth_real == o.higher[1, a, w].real


@pytest.mark.parametrize("path", [path for path in FILES if path.suffix == ".h5"], ids=lambda path: path.name)
def test_every_array_is_in_the_dataset(path):
    found = content(path)
    if isinstance(found, pj.Packing):
        return
    data = found.to_xarray()
    if isinstance(found, pj.md.Run):
        assert np.array_equal(data["elastic_xy"], found.rows["elastic_xy"])
        return
    for item in found._arrays():
        if getattr(found, item.name) is not None:
            assert np.array_equal(data[item.name], getattr(found, item.name), equal_nan=True)
            assert data[item.name].attrs["units"] == item.metadata["unit"]
    if isinstance(found, pj.ComplexModulus):
        assert data["values"].dims == ("omega",)
        assert data.attrs["law"] == found.damping.name


def test_a_spectrum_is_a_line_and_a_dataset(packing):
    model = pj.spectrum(packing, (1e-2, 1.0), prestress=False)
    data, (line,) = model.to_xarray(), model.to_dataframe().itertuples()
    assert (line.G0, line.eta0, line.G_inf, line.eta_inf) == (model.G0, model.eta0, model.G_inf, model.eta_inf)
    assert np.array_equal(data["K"], model.K)
    assert tuple(data["span"].values) == model.span
    assert "span: 0.01 … 1" in repr(model)


def test_states_and_networks_are_lines_and_tables(packing):
    network, state = pj.ContactNetwork.of(packing), pj.md.read(FORMATS / "ramp.h5").state
    assert repr(network).startswith("ContactNetwork(disks: 16, contacts: ")
    assert (network.to_dataframe().force == network.force).all()
    assert repr(state).startswith("State(disks: 24, cell: ")
    assert (state.to_dataframe()[["vx", "vy"]] == state.velocities).all(axis=None)


def test_tables_below_each_other():
    table = Table.stacked([Table({"a": np.array([1, 2]), "b": ["x", "y"]}), Table({"a": [3], "c": [0.5]})])
    assert table.to_csv().decode().splitlines() == ["a,b,c", "1,x,", "2,y,", "3,,0.5"]


@pytest.mark.parametrize(("module", "words"), [("pandas", "to_dataframe"), ("xarray", "to_xarray")])
def test_a_missing_package_names_the_extra(monkeypatch, packing, module, words):
    monkeypatch.setitem(sys.modules, module, None)
    g = next(iter(pj.read_moduli(FORMATS / "moduli.h5").values()))
    with pytest.raises(ImportError, match=r'pip install "petscjam\[tables\]"') as error:
        getattr(g, words)()
    assert isinstance(error.value, MissingError)
    with pytest.raises(ImportError, match=module):
        optional(module, "tables")


# Averages


def test_averages_of_lists_of_spectra_and_of_results(packing):
    settings = {"damping": pj.ContactDamping(beta=0.1), "prestress": False}
    model, g = pj.spectrum(packing, (1e-2, 1.0), **settings), pj.complex_modulus(packing, [0.1], **settings)
    assert pj.average([g, g]).mean == g.values
    assert pj.average({"a": g}).count == 1
    both = pj.average([model, model])
    assert both.omega[[0, -1]] == pytest.approx([1e-2, 1.0])
    assert np.array_equal(both.mean, model(both.omega))
    assert pj.average([g, model], [0.1]).mean[0] == pytest.approx(g.values[0], rel=1e-5)
    assert pj.average(model).count == 1
    with pytest.raises(InputError, match="average: 1 is a float"):
        pj.average([0.5])


# Folders


def test_a_folder_of_runs_is_read():
    runs = pj.md.read(FORMATS / "flows")
    assert runs.keys() == {path.stem for path in (FORMATS / "flows").glob("*.h5")}
    assert all(isinstance(run, pj.md.Run) for run in runs.values())
    with pytest.raises(InputError, match="library: there are no runs"):
        pj.md.read(FORMATS / "library")


# Laws


@pytest.mark.parametrize("name", LAWS)
def test_a_law_may_be_a_name(packing, name):
    g = pj.complex_modulus(packing, [1.0], damping=name, prestress=False)
    assert g.damping == LAWS[name]()
    assert g.values == pj.complex_modulus(packing, [1.0], damping=LAWS[name](), prestress=False).values
    assert pj.md.shear(name, n=16, phi=0.8, rate=1e-2, strain=0.01).settings.model.law == LAWS[name]()


@pytest.mark.parametrize(
    "function", [pj.complex_modulus, pj.viscosity, pj.relaxation_modes, pj.spectrum, pj.correlations]
)
def test_a_number_of_a_law_says_where_it_goes(packing, function):
    with pytest.raises(InputError, match=r"write damping=ContactDamping\(beta=0.1\)"):
        function(packing, beta=0.1)
    with pytest.raises(InputError, match=r"write model=StokesDrag\(eta_fluid=2\)"):
        pj.md.shear(eta_fluid=2)
    with pytest.raises(InputError, match='"contact", "stokes"'):
        function(packing, *[[1.0]] * (function in (pj.complex_modulus, pj.correlations)), damping="contacts")


# Numbers


@pytest.mark.parametrize("bad", ["abc", [[1, 2], [3]], [1j], {"a": 1}, ["1"]])
def test_what_is_no_array_of_numbers(packing, bad):
    settings = {"prestress": True}
    for name, call in {
        "omega": lambda: pj.complex_modulus(packing, bad),
        "amplitude": lambda: pj.oscillate(packing, bad, [1.0], **settings),
        "time": lambda: pj.step_strain(packing, [0.1], bad, **settings),
        "aqs": lambda: pj.aqs(packing, bad),
    }.items():
        with pytest.raises(InputError) as error:
            call()
        assert str(error.value).startswith(name)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: pj.complex_modulus("p.h5", [1.0]), "a Packing is needed"),
        (lambda: pj.lowest_modes("p.h5"), "a Packing is needed"),
        (lambda: pj.certify("p.h5"), "not 'p.h5'"),
        (lambda: pj.Packing("abc", [1], pj.Box([[1, 0], [0, 1]])), "an array of numbers is needed, not 'abc'"),
        (lambda: pj.Packing([[0, 0], [1]], [1, 1], pj.Box([[1, 0], [0, 1]])), "an array of numbers is needed"),
        (lambda: pj.Box([[1, 0], [0]]), "an array of numbers is needed"),
        (lambda: pj.prepare_library("none", [16], ["a"]), "pressures: needs a number"),
        (lambda: pj.md.read(FORMATS / "ramp.h5").mean([1.0, 2.0]), "10 values are needed"),
    ],
)
def test_what_is_no_packing_and_no_array(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_a_library_of_one_size(tmp_path):
    library = pj.prepare_library(tmp_path / "one", 16, 1e-2, 1)
    assert [row["particles"] for row in library.rows] == [16]


def test_one_error_is_one_traceback(tmp_path):
    (tmp_path / "p.h5").write_text("not HDF5")
    for call in (lambda: pj.Packing.read(tmp_path / "p.h5"), lambda: pj.Packing.read(tmp_path / "none.h5")):
        with pytest.raises(InputError) as error:
            call()
        assert "".join(traceback.format_exception(error.value)).count("Traceback") == 1


# Progress


def test_progress_is_shown_on_request(packing, capsys):
    for given, seen in ((True, True), (False, False), (None, False)):
        pj.complex_modulus(packing, [1.0], prestress=False, progress=given)
        assert ("complex modulus: 100 %" in capsys.readouterr().err) == seen
    said = []
    pj.complex_modulus(packing, [1.0], prestress=False, progress=lambda fraction, text: said.append(fraction))
    assert said[-1] == 1.0

"""Files for rheologists' programs hold the numbers of the model, and read back by the rules of RepTate."""

import numpy as np
import pytest
from helpers import sixteen

import petscjam as pj

SPAN = (1e-6, 1e2)
NEEDED = {"tts": (("w", "G'", "G''"), ("Mw", "T")), "gt": (("t", "Gt"), ("Mw", "gamma"))}


@pytest.fixture(scope="module")
def packing():
    return sixteen()


@pytest.fixture(scope="module")
def model(packing):
    return pj.spectrum(packing, SPAN, name="sixteen; x=1 φ\n", displacements=False)


@pytest.fixture(scope="module")
def direct(packing):
    return pj.complex_modulus(packing, [1e-3, 1e-1, 10.0])


def is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def reptate(path):
    """Parameters, names and columns of a file, as RepTate finds them by its ending.

    Line 1 holds key=value pairs between semicolons, blanks do not count. The last line before the data that
    contains every name is that of the columns; which are the first word equal to each name. Data begin at the
    first line of numbers only, an empty one included. Rows are sorted by the first column.
    """
    names, _ = NEEDED[path.suffix[1:]]
    lines = path.read_bytes().decode("latin-1").splitlines()
    pairs = [item.split("=") for item in lines[0].replace(" ", "").split(";")]
    parameters = {p[0]: float(p[1]) if is_number(p[1]) else p[1] for p in pairs if len(p) > 1}
    places, first = list(range(len(names))), None
    for number, line in enumerate(lines[1:], 1):
        if all(name in line for name in names):
            places = [line.split().index(name) for name in names]
        elif all(map(is_number, line.split())):
            first = number
            break
    rows = [[float(line.split()[place]) for place in places] for line in lines[first:] if line.split()]
    return parameters, np.array(sorted(rows)).T


def comma_separated(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = np.array([[float(x) for x in line.split(",")] for line in lines[1:]])
    return dict(zip(lines[0].split(","), rows.T, strict=True))


def test_tts_holds_the_model(model, tmp_path):
    pj.export_rheology(model, tmp_path / "g.tts", "tts")
    _, (w, storage, loss) = reptate(tmp_path / "g.tts")
    assert np.array_equal(storage + 1j * loss, model(w))


def test_frequencies_are_ten_a_decade_over_the_span(model, tmp_path):
    pj.export_rheology(model, tmp_path / "g.tts", "tts")
    _, (w, _, _) = reptate(tmp_path / "g.tts")
    assert np.array_equal(w, np.geomspace(*SPAN, 81))


def test_gt_holds_the_model(model, tmp_path):
    pj.export_rheology(model, tmp_path / "g.gt", "gt")
    _, (t, relaxing) = reptate(tmp_path / "g.gt")
    assert np.array_equal(relaxing, model.G(t))


def test_times_are_the_span_reversed(model, tmp_path):
    pj.export_rheology(model, tmp_path / "g.gt", "gt")
    _, (t, _) = reptate(tmp_path / "g.gt")
    assert np.allclose(t, np.geomspace(1e-2, 1e6, 81), rtol=1e-12)


@pytest.mark.parametrize("fmt", NEEDED)
def test_parameters_that_reptate_misses_or_uses(model, tmp_path, fmt):
    path = tmp_path / f"g.{fmt}"
    pj.export_rheology(model, path, fmt)
    parameters, _ = reptate(path)
    assert set(NEEDED[fmt][1]) <= set(parameters)
    assert parameters.get("gamma", 1) == 1  # G(t) is divided by it
    assert parameters["particles"] == 16
    assert parameters["phi"] == model.origin.phi
    assert parameters["pressure"] == model.origin.pressure


@pytest.mark.parametrize("fmt", NEEDED)
def test_no_name_breaks_the_first_line(model, tmp_path, fmt):
    path = tmp_path / f"g.{fmt}"
    pj.export_rheology(model, path, fmt)
    assert reptate(path)[0]["name"] == "sixteen__x_1___"
    assert path.read_bytes().isascii()


def test_frequencies_and_times_of_ones_own(model, tmp_path):
    w, t = [1e-3, 2.0], [0.0, 1.0, 5.0]
    pj.export_rheology(model, tmp_path / "g.tts", "tts", omegas=w)
    pj.export_rheology(model, tmp_path / "g.gt", "gt", times=t)
    assert np.array_equal(reptate(tmp_path / "g.tts")[1][0], w)
    assert np.array_equal(reptate(tmp_path / "g.gt")[1][0], t)


def test_csv_has_the_bounds(model, tmp_path):
    pj.export_rheology(model, tmp_path / "g.csv", "csv")
    columns = comma_separated(tmp_path / "g.csv")
    storage, loss = model.part_errors(columns["omega"])
    assert np.array_equal(columns["G_storage"] + 1j * columns["G_loss"], model(columns["omega"]))
    assert np.array_equal(columns["error_storage"], storage)
    assert np.array_equal(columns["error_loss"], loss)


def test_csv_of_a_direct_sweep_has_none(direct, tmp_path):
    pj.export_rheology(direct, tmp_path / "g.csv", "csv")
    assert list(comma_separated(tmp_path / "g.csv")) == ["omega", "G_storage", "G_loss"]


@pytest.mark.parametrize("sampled", [True, False])
def test_a_modulus_keeps_its_frequencies(model, direct, tmp_path, sampled):
    modulus = pj.ComplexModulus.sampled(model, direct.omega) if sampled else direct
    pj.export_rheology(modulus, tmp_path / "g.tts", "tts")
    _, (w, storage, loss) = reptate(tmp_path / "g.tts")
    assert np.array_equal(w, modulus.omega)
    assert np.array_equal(storage + 1j * loss, modulus.values)


def test_a_modulus_gives_what_its_model_knows(model, direct, tmp_path):
    modulus = pj.ComplexModulus.sampled(model, direct.omega)
    pj.export_rheology(modulus, tmp_path / "g.gt", "gt")
    pj.export_rheology(modulus, tmp_path / "g.tts", "tts", omegas=[1.0, 2.0])
    _, (t, relaxing) = reptate(tmp_path / "g.gt")
    assert np.array_equal(relaxing, model.G(t))
    assert np.array_equal(reptate(tmp_path / "g.tts")[1][0], [1.0, 2.0])


@pytest.mark.parametrize(
    ("fmt", "grid", "words"),
    [
        ("xls", {}, "tts, gt, csv, not xls"),
        ("gt", {"times": [1.0, -1.0]}, "times.*-1"),
        ("gt", {"times": [np.nan]}, "times.*nan"),
        ("gt", {"times": [np.inf]}, "times.*inf"),
        ("gt", {"times": []}, "times.*empty"),
        ("tts", {"omegas": [0.0]}, "omega.*0"),
        ("tts", {"times": [1.0]}, "times: tts has none"),
        ("gt", {"omegas": [1.0]}, "omegas: gt has none"),
    ],
)
def test_what_is_refused(model, tmp_path, fmt, grid, words):
    with pytest.raises(pj.InputError, match=words):
        pj.export_rheology(model, tmp_path / "g", fmt, **grid)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("fmt", "grid"), [("gt", {}), ("tts", {"omegas": [1.0]})])
def test_without_a_model(direct, tmp_path, fmt, grid):
    with pytest.raises(pj.InputError, match="needs a reduced model"):
        pj.export_rheology(direct, tmp_path / "g", fmt, **grid)


def test_a_file_that_exists_stays(model, direct, tmp_path):
    path = tmp_path / "g.tts"
    path.write_text("mine")
    with pytest.raises(pj.InputError, match="exists already"):
        pj.export_rheology(model, path, "tts")
    assert path.read_text() == "mine"
    pj.export_rheology(direct, path, "tts", overwrite=True)
    assert len(reptate(path)[1][0]) == 3

"""Every file and folder as one flat table, from the command."""

import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers import refused

import petscjam as pj
from petscjam.cli import main
from petscjam.io.results import read_results

pytestmark = pytest.mark.parallel(nprocs=1)
FORMATS = Path(__file__).parent / "fixtures" / "formats"
FILES = [*sorted(FORMATS.glob("*.h5")), FORMATS / "library", FORMATS / "flows"]


def exported(path, out, *options):
    assert main(["export", str(path), "-o", str(out), *options]) == 0
    return pd.read_parquet(out) if out.suffix == ".parquet" else read_csv(out.read_bytes())


def read_csv(text):
    return pd.read_csv(BytesIO(text), comment="#", float_precision="round_trip")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_everything_is_a_table(path, tmp_path):
    frame = exported(path, tmp_path / "t.parquet")
    assert len(frame) == len(pj.read_table(path)) > 0
    text = exported(path, tmp_path / "t.csv")
    assert len(text) == len(frame) or path.name in ("spectrum.h5", "stokes.h5", "direct.h5", "stokes-direct.h5")
    for name in frame.select_dtypes("number").columns.intersection(text.columns):
        assert np.array_equal(frame[name].astype(float), text[name], equal_nan=True)


def test_a_table_has_every_result_of_a_file(tmp_path):
    frame = exported(FORMATS / "moduli.h5", tmp_path / "g.csv")
    results = pj.read_moduli(FORMATS / "moduli.h5")
    assert list(frame.result.unique()) == list(results)
    for name, g in results.items():
        lines = frame[frame.result == name]
        assert np.array_equal(lines.G_storage + 1j * lines.G_loss, g.values)
        assert set(lines.prestress) == {g.prestress}
    some = exported(FORMATS / "moduli.h5", tmp_path / "some.csv", "--group", "*without*")
    assert len(some) == len(frame) / 2


def test_a_folder_of_results_is_one_table(tmp_path):
    for name in ("moduli", "stokes"):
        shutil.copy(FORMATS / f"{name}.h5", tmp_path / f"{name}.h5")
    frame = exported(tmp_path, tmp_path / "g.csv")
    assert set(frame.file) == {"moduli.h5", "stokes.h5"}
    assert frame[frame.file == "stokes.h5"].beta.isna().all()
    assert set(frame[frame.file == "stokes.h5"].eta_fluid) == {0.5}
    assert len(frame) == sum(len(g.omega) for f in set(frame.file) for g in read_results(tmp_path / f).values())


def test_a_folder_of_two_kinds_is_none(tmp_path, capfd):
    for name in ("moduli", "modes"):
        shutil.copy(FORMATS / f"{name}.h5", tmp_path / f"{name}.h5")
    err = refused(capfd, "export", tmp_path, "-o", tmp_path / "t.csv")
    assert "Modes (modes.h5), ComplexModulus (moduli.h5)" in err


def test_a_folder_of_runs_has_means_with_errors(tmp_path):
    frame = exported(FORMATS / "flows", tmp_path / "flow.csv")
    for line in frame.itertuples():
        run = pj.md.read(FORMATS / "flows" / f"{line.run}.h5")
        assert (line.stress, line.stress_error) == run.mean("stress")
        assert (line.rate, line.phi, line.law) == (run.settings.history["rate"], 0.8, "contact")


@pytest.mark.parametrize(
    ("given", "options", "words"),
    [
        ("modes.h5", ["-o", "x.gsd"], "formats are csv, parquet, not gsd"),
        ("packing.h5", ["-o", "x.gsd", "--to", "xyz"], "'.gsd' is the ending of gsd, not of xyz"),
        ("flows", ["-o", "x.tts"], "formats are csv, parquet, not tts"),
        ("ramp.h5", ["-o", "x.gt"], "formats are csv, parquet, lammps, not gt"),
        ("packing.h5", ["-o", "x.unknown"], "no format ends in '.unknown'"),
        ("modes.h5", ["-o", "x.csv", "--average"], "--average goes with moduli, not with Modes"),
        ("moduli.h5", ["-o", "x.parquet", "--omega", "1"], "--omega goes with one modulus"),
        ("moduli.h5", ["-o", "x.csv", "--group", "none"], "no result in"),
        ("flows", ["-o", "x.csv", "--group", "none"], "--group"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, capfd, monkeypatch, given, options, words):
    monkeypatch.chdir(tmp_path)
    assert words in refused(capfd, "export", FORMATS / given, *options)
    assert list(tmp_path.iterdir()) == []

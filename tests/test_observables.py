"""Observables of a run: one that is added is recorded everywhere; a run with fewer is read; any engine will do."""

from dataclasses import replace
from typing import ClassVar

import h5py
import numpy as np
import pytest
from test_shear import SMALL, StoppedError, same, stop_at

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.base.files import atomic_h5
from petscjam.cli import main
from petscjam.md import engine, runs
from petscjam.md.observables import BLOCKS, ROWS, AbsentError, Block, Row
from petscjam.md.result import export_csv
from petscjam.md.simulation import Simulation

pytestmark = pytest.mark.parallel(nprocs=1)
ESSENTIAL = "time", "strain", "rate"


def histogram(state):
    """Disks by peculiar velocity."""
    return np.histogram(np.hypot(*state.peculiar.T), [0, 1e-3, 1e-2, 1e-1, np.inf])[0]


@pytest.fixture
def more(monkeypatch):
    """Two rows and a block more, from sums and from states."""
    temperature = Row("m ds²/τe²", lambda i: (i.mean(engine.KXX) + i.mean(engine.KYY)) / (2 * i.disks), symbol="T")
    monkeypatch.setitem(ROWS, "temperature", temperature)
    monkeypatch.setitem(ROWS, "fastest", Row("ds/τe", sample=lambda s: np.hypot(*s.peculiar.T).max()))
    monkeypatch.setitem(BLOCKS, "speeds", Block("disks by peculiar velocity", "4", sample=histogram))


def test_an_added_observable_is_recorded_resumed_told_and_exported(tmp_path, more, capsys):
    file = tmp_path / "run.h5"
    whole = pj.md.shear(**SMALL)
    with pytest.raises(StoppedError):
        pj.md.shear(**SMALL, output=file, progress=stop_at(0.45))
    assert same(pj.md.shear(**SMALL, output=file, resume=True), whole) == []
    run = pj.md.read(file)
    assert same(run, whole) == []
    kinetic = (run.rows["kinetic_xx"] + run.rows["kinetic_yy"]) / 2 * run.state.length**2
    assert run.rows["temperature"] == pytest.approx(kinetic / 36, rel=1e-12)
    assert (run.rows["fastest"] ** 2 >= run.rows["temperature"]).all()
    assert (run.blocks["speeds"].sum(1) == 36 * run.blocks["samples"]).all()
    with h5py.File(file) as h5:
        assert h5["rows/temperature"].attrs["unit"] == "m ds²/τe²"
    assert main(["info", str(file)]) == 0
    mean = run.mean("temperature")
    assert f"T            {mean.value:.4g} ± {mean.error:.1g}" in capsys.readouterr().out
    export_csv(run, tmp_path / "run.csv")
    head, *lines = [line for line in (tmp_path / "run.csv").read_text().splitlines() if not line.startswith("#")]
    column = head.split(",").index("fastest")
    assert [float(line.split(",")[column]) for line in lines] == run.rows["fastest"].tolist()


def test_a_run_with_an_observable_that_is_unknown_is_read_but_not_resumed(tmp_path, monkeypatch):
    file = tmp_path / "run.h5"
    with monkeypatch.context() as patch:
        patch.setitem(ROWS, "disks", Row("1", lambda i: i.disks))
        pj.md.shear(**SMALL, output=file)
    assert (pj.md.read(file).rows["disks"] == 36).all()
    with pytest.raises(InputError, match=r"run\.h5: holds observables that are unknown here: disks"):
        pj.md.shear(**SMALL | {"strain": 0.7}, output=file, resume=True)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run that was stopped, and the whole one."""
    file = tmp_path_factory.mktemp("run") / "run.h5"
    with pytest.raises(StoppedError):
        pj.md.shear(**SMALL, output=file, progress=stop_at(0.45))
    return file, pj.md.shear(**SMALL)


@pytest.mark.parametrize("name", ROWS)
def test_a_run_without_a_row_is_read_told_and_resumed(stopped, tmp_path, capsys, name):
    file, (source, whole) = tmp_path / "run.h5", stopped
    file.write_bytes(source.read_bytes())
    with atomic_h5(file, existing=True) as h5:
        del h5["rows"][name]
    if name in ESSENTIAL:
        with pytest.raises(InputError, match=f"rows: {name} is missing"):
            pj.md.read(file)
        return
    run = pj.md.read(file)
    older = ROWS[name].older
    if older is None:
        with pytest.raises(AbsentError, match=f"'{name}'"):
            run.rows[name]
        with pytest.raises(AbsentError, match=f"'{name}'"):
            run.mean(name)
    else:
        assert (run.rows[name] == older).all()
    assert main(["info", str(file)]) == 0, capsys.readouterr().err
    resumed = pj.md.shear(**SMALL, output=file, resume=True)
    assert same(resumed, replace(whole, rows={key: whole.rows[key] for key in resumed.rows})) == []
    assert whole.rows.keys() - resumed.rows.keys() == ({name} if older is None else set())


class Stranger:
    """An engine with what the protocol names, and nothing else."""

    CHECKPOINT = Simulation.CHECKPOINT
    NAMES: ClassVar = {
        name for name in {**vars(engine.Engine), **engine.Engine.__annotations__} if not name.startswith("_")
    }

    def __init__(self, state, model, dt, integrator, threads):
        self.inside = Simulation(state, model, dt, integrator, threads)

    @classmethod
    def restored(cls, saved, model, dt, integrator, threads):
        new = cls.__new__(cls)
        new.inside = Simulation.restored(saved, model, dt, integrator, threads)
        return new

    def __len__(self):
        return len(self.inside)

    def __getattr__(self, name):
        assert name in self.NAMES, name
        return getattr(self.inside, name)


def test_an_engine_is_a_class_and_a_line_in_a_list(tmp_path, monkeypatch):
    """A run asks an engine for nothing but what the protocol names."""
    monkeypatch.setitem(runs.ENGINES, "strange", Stranger)
    file, given = tmp_path / "run.h5", SMALL | {"engine": "strange"}
    with pytest.raises(StoppedError):
        pj.md.shear(**given, output=file, progress=stop_at(0.45))
    assert same(pj.md.shear(**given, output=file, resume=True), pj.md.shear(**SMALL)) == []


def test_an_engine_that_is_not_there():
    with pytest.raises(InputError, match="no engine 'abacus'; there are cpu"):
        pj.md.shear(**SMALL, engine="abacus")

"""Means over packings: standard errors, and which results are averaged together."""

from types import SimpleNamespace

import numpy as np
import pytest

import petscjam as pj
from petscjam.analysis.statistics import alike, by_pressure, deviation, means, nominal, standard_error
from petscjam.base.types import per_decade
from petscjam.plots.tables import describe_library
from petscjam.preparation.library import Library


def result(pressure, *, particles=64, prestress=True, damping="CD", omega=(0.1, 1.0)):
    origin = SimpleNamespace(pressure=pressure, particles=particles, damping=damping)
    return SimpleNamespace(origin=origin, prestress=prestress, omega=np.array(omega))


def test_means_and_standard_errors():
    mean, error = means([[1.0, 3.0], [5.0], [2.0, 2.0, 2.0, 6.0]])
    assert mean == pytest.approx([2, 5, 3])
    assert error == pytest.approx([1, np.nan, 1], nan_ok=True)  # of deviations −1, −1, −1, 3: (12/3/4)^½


def test_the_error_of_a_complex_mean_has_two_parts():
    samples = np.array([[1 + 5j], [3 + 5j], [5 - 1j]])
    assert deviation(samples) == pytest.approx([2 + 12**0.5 * 1j])
    assert standard_error(samples) == pytest.approx([(2 + 12**0.5 * 1j) / 3**0.5])
    assert np.isnan([standard_error(samples[:1]).real, standard_error(samples[:1]).imag]).all()


@pytest.mark.parametrize(("pressure", "same"), [(1.0004e-3, True), (0.9996e-3, True), (1.04e-3, False)])
def test_plots_tables_and_figures_group_packings_at_the_same_pressures(pressure, same):
    some = {"a": result(1e-3), "b": result(pressure)}
    groups = 1 if same else 2
    assert len(alike(some)) == groups
    assert len(by_pressure(some.values())) == groups
    row = {"target": None, "phi": 0.85, "Z": 4.0, "rattlers": 1, "lowest_eigenvalue": None, "seconds": None}
    row |= {"particles": 64, "proved": True, "shear_modulus": None}
    rows = [{**row, "pressure": r.origin.pressure} for r in some.values()]
    table = describe_library(Library(None, {}, rows, []))
    assert sum(line.startswith("     64 ") for line in table.splitlines()) == groups


@pytest.mark.parametrize(
    "other", [{"particles": 65}, {"prestress": False}, {"damping": "RD"}, {"omega": (0.1, 2.0)}, {"pressure": 2e-3}]
)
def test_unlike_results_are_not_averaged(other):
    one, two = result(1e-3), result(**{"pressure": 1e-3, **other})
    assert list(alike({"a": one, "b": two}).values()) == [{"a": one}, {"b": two}]


def test_pressures_rise_and_attributes_select():
    some = [result(p, prestress=kept) for p in (1e-2, 3.16228e-4, 1e-3) for kept in (True, False)]
    groups = by_pressure(some, prestress=False)
    assert list(groups) == [3.16e-4, 1e-3, 1e-2]
    assert [[r.prestress for r in some] for some in groups.values()] == [[False]] * 3


def test_nominal_pressures_of_a_prepared_packing_are_its_target():
    packing = pj.prepare_packing(32, 1.78e-3, 1)
    assert nominal(pj.ContactNetwork.of(packing).pressure) == 1.78e-3


@pytest.mark.parametrize(
    ("points", "low", "high", "count"), [(10, 1e-8, 1e2, 101), (4, 1.0, 10.0, 5), (32, 2.0, 2.0, 1)]
)
def test_a_grid_per_decade(points, low, high, count):
    grid = per_decade(points, low, high)
    assert len(grid) == count
    assert grid[[0, -1]] == pytest.approx([low, high], rel=1e-15)
    assert (np.diff(np.log10(grid)) <= 1 / points + 1e-12).all()

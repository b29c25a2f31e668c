"""Boundaries of coexistence, its end point, and jumps in ramps, on curves whose answer is known."""

import numpy as np
import pytest

from petscjam.analysis.coexistence import end_point, jump, jumps, kinks, loop, switches

PHI = np.arange(0.76, 0.8201, 0.005)


def lines(x, first=0.788, second=0.806, slopes=(20.0, 120.0, 30.0)):
    """Return three connected lines."""
    low, middle, high = slopes
    return low * x + (middle - low) * np.maximum(x - first, 0) + (high - middle) * np.maximum(x - second, 0)


def seeds(curve, noise, count=4):
    return curve + noise * np.random.default_rng(1).standard_normal((count, len(curve)))


def test_kinks_of_three_lines():
    found = kinks(PHI, np.exp(seeds(lines(PHI), 0.03)))
    for side, at in ((found.bagnoldian, 0.788), (found.newtonian, 0.806)):
        assert abs(side.value - at) < 2 * side.error
        assert 0.005 / 12**0.5 <= side.error < 0.004


def test_a_divergence_has_no_kinks():
    found = kinks(PHI, [(0.8433 - PHI) ** -2])
    assert np.isnan(found.bagnoldian.value)
    assert np.isnan(found.newtonian.error)


def test_kinks_need_six_points():
    assert np.isnan(kinks(PHI[:5], [np.exp(lines(PHI[:5]))]).bagnoldian.value)


def test_friction_switches_from_its_minimum_to_its_maximum():
    curve = 0.35 - 0.5 * (PHI - 0.76) + 0.03 * np.clip((PHI - 0.785) / 0.02, 0, 1)
    found = switches(PHI, seeds(curve, 1e-4), np.full(len(PHI), 1e-4))
    assert found.bagnoldian.value == pytest.approx(0.785)
    assert found.newtonian.value == pytest.approx(0.805)
    assert found.newtonian.error >= 0.005 / 12**0.5
    assert np.isnan(switches(PHI, [curve], np.full(len(PHI), 0.01)).bagnoldian.value)  # within errors
    rising = switches(PHI, [np.arange(len(PHI))], np.full(len(PHI), 1e-4))
    assert np.isnan([rising.bagnoldian.value, rising.newtonian.value]).all()  # the ends are not in the range


def test_banding_jumps_between_two_points():
    Rv = np.where((PHI > 0.786) & (PHI < 0.804), 100.0, 1.5)
    found = jumps(PHI, [Rv, Rv], 10)
    assert found.bagnoldian.value == pytest.approx(0.7875)
    assert found.newtonian.value == pytest.approx(0.8025)
    assert found.newtonian.error == pytest.approx(0.005 / 12**0.5)
    assert np.isnan(jumps(PHI, [np.full(len(PHI), 9.0)], 10).newtonian.value)
    assert np.isnan(jumps(PHI[3:9], [np.full(6, 99.0)], 10).bagnoldian.value)


def test_seeds_that_differ_increase_the_error_of_a_jump():
    early, late = (np.where((start < PHI) & (PHI < 0.811), 100.0, 1.0) for start in (0.771, 0.801))
    assert jumps(PHI, [early, late], 10).bagnoldian.error > 0.005


@pytest.mark.parametrize("exponent", [0.5, 1.0])
def test_the_end_point_within_its_error(exponent):
    x = np.log(np.geomspace(2e-5, 1e-4, 6))
    gap = 0.02 * (np.log(2e-4) - x) ** exponent
    found = end_point(x, gap, np.full(6, 2e-4))
    assert abs(found.value - np.log(2e-4)) <= 1.01 * found.error


def test_no_end_point_without_a_decrease():
    x = np.linspace(-10, -8, 5)
    assert np.isnan(end_point(x, np.full(5, 0.02), np.full(5, 1e-3)).value)
    assert np.isnan(end_point(x, 0.02 + 0.01 * (x + 10), np.full(5, 1e-4)).value)
    assert np.isnan(end_point(x[:2], [0.02, 0.01], [1e-4, 1e-4]).value)
    assert np.isnan(end_point([], [], []).value)


@pytest.mark.parametrize("way", [1, -1])
def test_the_jump_of_a_ramp(way):
    rate = np.geomspace(1e-5, 1e-3, 201)
    stress = np.where(rate < 1e-4, 1e2 * rate**2, 0.1 * rate) * np.exp(seeds(np.zeros(201), 0.1, 1)[0])
    found = jump(rate[::way], stress[::way], 4)
    assert np.log10(found.rate / 1e-4) == pytest.approx(0, abs=0.03)
    assert found.decades == pytest.approx(1 + 4 * 0.01 * 1.5, abs=0.12)


def test_the_area_of_a_loop():
    rate = np.geomspace(1e-5, 1e-3, 2001)
    up = np.where(rate < 1e-4, 1e2 * rate**2, 0.1 * rate)
    down = np.where(rate < 3e-5, 1e2 * rate**2, 0.1 * rate)  # between: higher by 1e-3/γ̇
    x = np.log10([3e-5, 1e-4])
    area = np.diff(-3 * x - x**2 / 2)[0]  # of log10(1e-3/γ̇)
    assert loop((rate, up), (rate[::-1], down[::-1])) == pytest.approx(area, rel=0.01)
    assert loop((rate, down), (rate, up)) == pytest.approx(-area, rel=0.01)
    assert np.isnan(loop((rate, -up), (rate, down)))


def test_rows_without_a_positive_stress_are_left_out():
    rate = np.geomspace(1e-5, 1e-3, 50)
    stress = np.where(np.arange(50) % 5, rate**2, -1.0)
    assert np.isfinite(jump(rate, stress, 3).rate)
    assert np.isnan(jump(rate, -rate, 3).rate)

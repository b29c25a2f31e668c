"""Means of sheared runs and over seeds against closed forms, and the side of a transition that a run is on."""

from dataclasses import replace

import numpy as np
import pytest
from test_shear_plots import synthetic_run

from petscjam.analysis.flows import falls, log_contacts, mean, newtonian, over_seeds


def with_rows(seed=0, **rows):
    run = synthetic_run(seed=seed)
    return replace(run, rows={**run.rows, **rows})


def test_rates_and_durations_of_contacts_are_ratios_of_sums():
    """The jackknife error with a constant denominator is that of a mean; relative errors of factors are added."""
    made, broken = np.random.default_rng(1).uniform(50, 150, 200), np.full(200, 30.0)
    run = with_rows(made=made, broken=broken, duration=2.5 * made)
    late, interval = made[50:], np.diff(run.time)[0] * run.settings.particles
    blocks = late.reshape(10, 15).mean(1)
    error = blocks.std(ddof=1) / 10**0.5
    rate, duration, product = (mean(run, what) for what in ("collision_rate", "duration_time", "product"))
    assert rate == pytest.approx((late.mean() / interval, error / interval))
    assert duration == pytest.approx((2.5 * late.mean() / 30, 2.5 * error / 30))
    assert product.value == pytest.approx(2 * rate.value * duration.value)
    assert product.error / product.value == pytest.approx(2**0.5 * error / late.mean())


def test_the_error_over_seeds_is_their_scatter():
    """That of a single run is its own."""
    runs = [with_rows(contacts=np.full(200, z)) for z in (1.0, 3.0, 5.0)]
    assert over_seeds(runs, "contacts") == pytest.approx((3.0, 2 / 3**0.5))
    noisy = with_rows()
    assert over_seeds([noisy], "contacts") == mean(noisy, "contacts") == noisy.mean("contacts")
    assert noisy.mean("contacts").error > 0


def test_the_newtonian_share():
    """The first quarter of the strain is left out."""
    contacts = np.repeat([3.0, 0.1, 3.0, 0.1], [50, 30, 90, 30])
    assert newtonian(with_rows(contacts=contacts), 1.0) == pytest.approx(0.6)


def test_where_Z_falls_most():
    """By a factor 3, or nowhere."""
    runs = {
        Q: [with_rows(contacts=np.full(200, z)) for z in pair] for Q, pair in ((1, (2, 8)), (2, (1, 1)), (5, (0, 0)))
    }
    logs = {Q: log_contacts(some) for Q, some in runs.items()}
    least = 0.02 / runs[1][0].settings.particles
    assert list(logs.values()) == pytest.approx([np.log(4), 0.0, np.log(least)])
    assert falls(logs) == (2, 5)
    assert falls({1: np.log(2.9), 2: 0.0}) is None
    assert falls({1: np.log(3.1), 2: 0.0}) == (1, 2)

"""Means of sheared runs and over their seeds, and the share of the strain in the Newtonian state (VOT secs. II, III).

Axes: k row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.statistics import standard_error
from petscjam.md.result import Mean, Run


def mean(run: Run, what: str) -> Mean:
    """Return a time mean and its error; τdur, νcoll and their product are ratios of sums over the rows.

    Parameters
    ----------
    run : Run
    what : str
        A row or a property of the run, or ``duration_time`` (τdur/τe), ``collision_rate`` (νcoll τe) or
        ``product`` (2 τdur νcoll, VOT eq. 25).
    """
    late, window = run.after(), np.diff(run.time, prepend=run.settings.time0)
    if what == "duration_time":
        return _ratio(run.rows["duration"][late], run.rows["broken"][late])
    if what == "collision_rate":
        return _ratio(run.rows["made"][late], window[late] * run.settings.particles)
    if what == "product":
        time, rate = mean(run, "duration_time"), mean(run, "collision_rate")
        value = 2 * time.value * rate.value
        return Mean(value, value * float(np.hypot(time.error / time.value, rate.error / rate.value)))
    return run.mean(what)


def _ratio(above: ArrayLike, below: ArrayLike) -> Mean:
    """Return Σ above / Σ below and its jackknife error over ten blocks of rows."""
    count = min(10, np.size(above))
    parts = [np.array([some.sum() for some in np.array_split(values, count)]) for values in (above, below)]
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = parts[0].sum() / parts[1].sum()
        left = (parts[0].sum() - parts[0]) / (parts[1].sum() - parts[1])
    return Mean(float(whole), float(np.sqrt((count - 1) / count * ((left - left.mean()) ** 2).sum())))


def over_seeds(runs: Sequence[Run], what: str) -> Mean:
    """Return the mean over seeds of :func:`mean` and its error: over seeds, or that of a single run.

    Parameters
    ----------
    runs : sequence of Run
    what : str
    """
    found = [mean(run, what) for run in runs]
    values = np.array([one.value for one in found])
    if len(values) == 1:
        return found[0]
    return Mean(float(values.mean()), float(standard_error(values)))


def newtonian(run: Run, threshold: float) -> float:
    """Return the share of the strain, without the first quarter, at which Z is above ``threshold``.

    Parameters
    ----------
    run : Run
    threshold : float
        Mean contacts of a disk.
    """
    return float((run.contacts[run.after()] > threshold).mean())


def falls(logs: Mapping[float, float], least: float = 3.0) -> tuple[float, float] | None:
    """Return the two values of Q between which Z falls most; None if it falls by less than a factor ``least``.

    Parameters
    ----------
    logs : mapping
        ln Z at each Q (:func:`log_contacts`), Q ascending.
    least : float
    """
    Qs, y = list(logs), np.array(list(logs.values()))
    k = int(np.diff(y).argmin())
    return (Qs[k], Qs[k + 1]) if y[k] - y[k + 1] > np.log(least) else None


def log_contacts(runs: Sequence[Run]) -> float:
    """Return the mean of ln Z over seeds; a run without contacts counts as one with a contact in 1/100 of the time."""
    least = [0.02 / run.settings.particles for run in runs]
    return float(np.mean([np.log(max(run.mean("contacts").value, z)) for run, z in zip(runs, least, strict=True)]))

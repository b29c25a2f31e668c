"""Histories of the strain rate, as data: γ̇ of each step, duration, and effect of a change on the disks.

Axes: k step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import log10
from typing import Any

import numpy as np

from petscjam.base import ranges
from petscjam.base.errors import InputError, shown
from petscjam.base.types import Array


@dataclass(frozen=True)
class Protocol:
    """A strain-rate history.

    Attributes
    ----------
    name : str
    rates : callable
        γ̇ in 1/τe at times (K,) in τe from the start.
    duration : float
        In τe.
    bulk : str
        Effect of a change of the rate: ``scale``, ``profile`` or ``boundary``
        (:meth:`petscjam.md.simulation.Simulation.advance`).
    settings : dict
        Its parameters.
    row_time : float
        τe between two rows of the time series; None: the default number of rows.
    period : float
        τe; rows are shorter than a 32nd of it. None: not periodic.
    """

    name: str
    rates: Callable[[Array], Array]
    duration: float
    bulk: str
    settings: dict[str, Any] = field(default_factory=dict)
    row_time: float | None = None
    period: float | None = None


def steady(rate: float, strain: float, bulk: str = "scale") -> Protocol:
    """Shear at a constant rate.

    Parameters
    ----------
    rate : float
        1/τe, not 0.
    strain : float
        Above 0.
    bulk : str
        Effect of a start at another rate on velocities, a name from ``BULK``.

    Raises
    ------
    InputError
        If a number is out of range.
    """
    _check_rate(rate)
    ranges.STRAIN.check("shear: the strain", strain)
    return Protocol("steady", lambda t: np.full(len(t), float(rate)), strain / abs(rate), bulk, {"rate": rate})


def ramp(rate: float, to: float, kappa: float) -> Protocol:
    """Increase γ̇ by a factor 10^κ̃ every τe, and decrease it again (VOT eqs. 38–41).

    Velocities and spins are scaled with the rate.

    Parameters
    ----------
    rate, to : float
        First and highest rate, 1/τe; if ``to`` is lower, the rate decreases first.
    kappa : float
        κ̃.

    Raises
    ------
    InputError
        If a number is out of range, or both rates are the same.
    """
    for name, value, known in (
        ("rate", rate, ranges.RATE_SIZE),
        ("to", to, ranges.RATE_SIZE),
        ("kappa", kappa, ranges.KAPPA),
    ):
        known.check(f"ramp: {name}", value)
    if rate == to:
        raise InputError(f"ramp: it begins and turns at the same strain rate, {shown(rate)}")
    updates = int(np.ceil(abs(log10(to / rate)) / kappa))
    sign = 1 if to > rate else -1

    def rates(t: Array) -> Array:
        done = np.floor(t)
        exponent = np.where(done < updates, done, 2 * updates - 1 - done)
        return rate * 10.0 ** (sign * kappa * exponent)

    settings = {"rate": rate, "to": to, "kappa": kappa}
    return Protocol("ramp", rates, 2.0 * updates, "scale", settings, row_time=1e3)  # VOT sec. III D


def steps(rates: Sequence[float], strains: Sequence[float], bulk: str = "scale") -> Protocol:
    """Shear at several strain rates in sequence: a step of the rate or, with a last rate of 0, cessation of shear.

    Parameters
    ----------
    rates : sequence of float
        1/τe.
    strains : sequence of float
        Strain at each rate; at a rate of 0 a time, τe.
    bulk : str
        Effect of a change of the rate on velocities, a name from ``BULK``.

    Raises
    ------
    InputError
        If the numbers of rates and strains differ, or a number is out of range.
    """
    if len(rates) != len(strains) or len(rates) == 0:
        raise InputError(f"shear: {len(rates)} strain rates but {len(strains)} strains")
    if len(rates) > ranges.MOST_CHANGES:
        raise InputError(f"shear: {len(rates)} strain rates; at most {ranges.MOST_CHANGES} in one run")
    for rate, strain in zip(rates, strains, strict=True):
        if rate != 0:
            _check_rate(rate)
        ranges.STRAIN.check("shear: the strain", strain)
    times = [strain / abs(rate) if rate else strain for rate, strain in zip(rates, strains, strict=True)]
    ends, values = np.cumsum(times), np.array(rates, dtype=float)
    if bulk == "scale" and (values == 0).any():
        bulk = "profile"
    settings = {"rate": float(rates[0]), "rates": list(map(float, rates)), "strains": list(map(float, strains))}
    return Protocol(
        "steps",
        lambda t: values[np.minimum(np.searchsorted(ends, t, side="right"), len(values) - 1)],
        float(ends[-1]),
        bulk,
        settings,
    )


def oscillation(amplitude: float, omega: float, cycles: float) -> Protocol:
    """Shear as γ = γ0 sin ωt; the change of the linear profile is added to the velocities.

    Parameters
    ----------
    amplitude : float
        γ0.
    omega : float
        ω in 1/τe.
    cycles : float
    """
    for name, value, known in (
        ("amplitude", amplitude, ranges.AMPLITUDE),
        ("omega", omega, ranges.SWING),
        ("cycles", cycles, ranges.CYCLES),
    ):
        known.check(f"shear: the {name}", value)
    ranges.RATE_SIZE.check("shear: amplitude × omega", amplitude * omega)
    settings = {"rate": amplitude * omega, "amplitude": amplitude, "omega": omega, "cycles": cycles}
    period = 2 * np.pi / omega

    def rates(t: Array) -> Array:
        return amplitude * omega * np.cos(omega * t)

    return Protocol("oscillation", rates, period * cycles, "profile", settings, period=period)


def _check_rate(rate: float) -> None:
    ranges.RATE.check("shear: the strain rate", rate)
    if abs(rate) not in ranges.RATE_SIZE:
        raise InputError(f"shear: the size of the strain rate must be {ranges.RATE_SIZE}, not {shown(abs(rate))}")

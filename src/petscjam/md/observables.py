"""What a run records: a number for each interval (rows), and an array for each block of intervals.

An observable is an entry of :data:`ROWS` or :data:`BLOCKS`, which the file, ``info``, the time means and the
export use. Units: ds, m, τe.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.types import Array, Integers
from petscjam.md import engine
from petscjam.md.engine import BINS, LAYERED, TICKS, Totals
from petscjam.md.state import State

SAMPLES = 5  # of disks and contacts, in each row
ROWS_PER_BLOCK = 50


@dataclass
class Interval:
    """Sums of the engine over one interval of the time series.

    Attributes
    ----------
    disks : int
    area, dt : float
        Of the cell in ds², and the time step in τe.
    time, strain : float
        At the end.
    rate : float
        Mean γ̇.
    steps, substeps, parts, rebuilds : int
        Numbers of time steps, of their parts, largest number of parts of one step, and lists of pairs.
    totals : Totals
        Sums over the steps.
    samples : int
    sums : (SAMPLED,)
        Over the samples (:meth:`petscjam.md.engine.Engine.sample`).
    before, energy : float
        Energy at the beginning and at the end.
    sampled : dict
        Means over the samples of observables of states.
    """

    disks: int
    area: float
    dt: float
    time: float
    strain: float
    rate: float
    steps: int
    substeps: int
    parts: int
    rebuilds: int
    totals: Totals
    samples: int
    sums: Array
    before: float
    energy: float
    sampled: Mapping[str, float] = field(default_factory=dict)

    def mean(self, which: int) -> float:
        """Return the mean over the steps of a sum, as ``HEAT``."""
        return float(self.totals.sums[which] / self.steps)

    def integral(self, which: int) -> float:
        """Return the integral over time of a sum."""
        return float(self.totals.sums[which] * self.dt)

    def per_disk(self, which: int) -> float:
        """Return the mean over disks and samples of a sum of the samples, as ``SPIN``."""
        return float(self.sums[which] / (self.disks * self.samples))

    def per_contact(self, which: int) -> float:
        """Return the mean over contacts and samples of a sum of the samples, as ``NORMAL2``."""
        return float(self.sums[which] / max(self.sums[engine.CONTACTS], 1.0))


@dataclass(frozen=True)
class Row:
    """An observable with a number in each row.

    Parameters
    ----------
    unit : str
        Unit and meaning.
    take : callable
        Its value from an :class:`Interval`.
    sample : callable
        Its value from a :class:`petscjam.md.state.State`, instead: the row is the mean over :data:`SAMPLES` times.
    symbol : str
        Symbol of its time mean in ``info``; empty: not printed.
    older : float
        Its value in files of versions that did not record it; None: absent.
    """

    unit: str
    take: Callable[[Interval], float] | None = None
    sample: Callable[[State], float] | None = None
    symbol: str = ""
    older: float | None = None

    def value(self, interval: Interval, name: str) -> float:
        """Return its value in an interval.

        Parameters
        ----------
        interval : Interval
        name : str
            Of the observable.
        """
        return interval.sampled[name] if self.take is None else self.take(interval)


def _pressure(which: int) -> Row:
    return Row("m/τe²", lambda interval: interval.mean(which) / interval.area)


def _imbalance(i: Interval) -> float:
    return i.energy - i.before - i.integral(engine.WORK) - float(i.totals.sums[engine.JUMPS]) + i.integral(engine.HEAT)


# Means over an interval, except where the unit says otherwise. The pressure tensor is VOT's eqs. 12–14: first
# index force or velocity, second index separation; dissipative_yx is listed because in model CD it differs from
# _xy.
ROWS: dict[str, Row] = {
    "time": Row("τe, at the end of the interval", lambda i: i.time),
    "strain": Row("at the end", lambda i: i.strain),
    "rate": Row("1/τe", lambda i: i.rate),
    "elastic_xx": _pressure(engine.EXX),
    "elastic_xy": _pressure(engine.EXY),
    "elastic_yy": _pressure(engine.EYY),
    "dissipative_xx": _pressure(engine.DXX),
    "dissipative_xy": _pressure(engine.DXY),
    "dissipative_yx": _pressure(engine.DYX),
    "dissipative_yy": _pressure(engine.DYY),
    "kinetic_xx": _pressure(engine.KXX),
    "kinetic_xy": _pressure(engine.KXY),
    "kinetic_yy": _pressure(engine.KYY),
    "contacts": Row("Z", lambda i: 2 * i.mean(engine.TOUCHING) / i.disks),
    "energy": Row("m ds²/τe², at the end: elastic, peculiar kinetic and rotational", lambda i: i.energy),
    "work": Row("m ds²/τe² done by the shear stress in the interval", lambda i: i.integral(engine.WORK)),
    "jumps": Row("m ds²/τe² brought by sudden changes of the strain rate", lambda i: i.totals.sums[engine.JUMPS]),
    "heat": Row("m ds²/τe² dissipated in the interval", lambda i: i.integral(engine.HEAT)),
    "imbalance": Row("m ds²/τe², change of energy − work − jumps + heat: the error of the energy budget", _imbalance),
    "made": Row("contacts made in the interval", lambda i: i.totals.counts[0]),
    "broken": Row("contacts broken", lambda i: i.totals.counts[1]),
    "duration": Row("τe, sum over the contacts broken", lambda i: i.totals.counts[2] * i.dt / TICKS),
    "spin": Row("1/τe, mean θ̇", lambda i: i.per_disk(engine.SPIN)),
    "spin_variance": Row(
        "1/τe², over disks and time", lambda i: i.per_disk(engine.SPIN2) - i.per_disk(engine.SPIN) ** 2
    ),
    "dvx2": Row("ds²/τe² (VOT eq. 35)", lambda i: i.per_disk(engine.DVX2)),
    "vy2": Row("ds²/τe² (VOT eq. 36)", lambda i: i.per_disk(engine.VY2)),
    "normal2": Row("ds²/τe², mean square normal velocity of contacts", lambda i: i.per_contact(engine.NORMAL2)),
    "tangential2": Row("ds²/τe²", lambda i: i.per_contact(engine.TANGENTIAL2)),
    "steps": Row("time steps, each part counted", lambda i: i.substeps),
    "parts": Row("largest number of parts of a time step dt", lambda i: i.parts, older=1.0),
    "rebuilds": Row("neighbour lists built", lambda i: i.rebuilds),
}


@dataclass
class BlockSums:
    """Sums over the current block of intervals.

    Attributes
    ----------
    angles : (2, BINS) integers
        Collision angles at making and at breaking.
    layers, moments : (LAYERED, M), (5, 4)
        Over the samples (:meth:`petscjam.md.engine.Engine.sample`).
    scatter : (S, 4)
        One row for each sample; NaN without a sample or a contact.
    looked : (2,) integers
        Samples, and contacts in them.
    sampled : dict
        Sums over the samples of observables of states.
    strain : float
        γ at the end of the block.
    """

    angles: Integers
    layers: Array
    moments: Array
    scatter: Array
    looked: Integers
    sampled: dict[str, Any] = field(default_factory=dict)
    strain: float = np.nan

    @classmethod
    def empty(cls, layers: int) -> BlockSums:
        """Return the sums of a new block, with this number of ``layers`` in y."""
        scatter = np.full((SAMPLES * ROWS_PER_BLOCK, 4), np.nan)
        angles, looked = np.zeros((2, BINS), np.int64), np.zeros(2, np.int64)
        return cls(angles, np.zeros((LAYERED, layers)), np.zeros((5, 4)), scatter, looked)

    @property
    def arrays(self) -> dict[str, Array]:
        """The arrays of a checkpoint, by name."""
        own = {name: getattr(self, name) for name in ("angles", "layers", "moments", "scatter", "looked")}
        return {f"block_{name}": np.array(values) for name, values in (own | self.sampled).items()}

    @classmethod
    def restored(cls, saved: Mapping[str, Any]) -> BlockSums:
        """Return the sums of a checkpoint; those of older files have no stress by layer."""
        found = {name.removeprefix("block_"): np.array(v) for name, v in saved.items() if name.startswith("block_")}
        own: dict[str, Any] = {name: found.pop(name) for name in ("angles", "layers", "moments", "scatter")}
        layers = np.zeros((LAYERED, own["layers"].shape[1]))
        layers[: len(own["layers"])] = own["layers"][:LAYERED]
        return cls(**own | {"layers": layers}, looked=found.pop("looked").astype(np.int64), sampled=found)


CHECKPOINT = {
    "block_angles": f"2 {BINS}",
    "block_layers": "K M",
    "block_moments": "5 4",
    "block_scatter": "S 4",
    "block_looked": "2",
}


@dataclass(frozen=True)
class Block:
    """An observable with an array for each block of rows.

    Parameters
    ----------
    unit : str
        Unit and meaning.
    shape : str
        Axes for each block (:func:`petscjam.base.files.check_shapes`), as ``"M"``.
    take : callable
        Its values from the :class:`BlockSums`.
    sample : callable
        Its values from a :class:`petscjam.md.state.State`, instead: they are summed over :data:`SAMPLES` times of
        each row.
    """

    unit: str
    shape: str = ""
    take: Callable[[BlockSums], Any] | None = None
    sample: Callable[[State], Any] | None = None

    def value(self, block: BlockSums, name: str) -> Any:
        """Return its values in a block.

        Parameters
        ----------
        block : BlockSums
        name : str
            Of the observable.
        """
        return block.sampled[name] if self.take is None else self.take(block)


# Sums over a block; M is the number of layers in y, each about ds high.
BLOCKS: dict[str, Block] = {
    "strain": Block("at the end of the block", "", lambda b: b.strain),
    "samples": Block("times at which disks and contacts were sampled", "", lambda b: b.looked[0]),
    "making": Block("contacts made by collision angle ϑ, from −180°", f"{BINS}", lambda b: b.angles[0]),
    "breaking": Block("contacts broken", f"{BINS}", lambda b: b.angles[1]),
    "layer_disks": Block("disks by layer", "M", lambda b: b.layers[0]),
    "layer_vx": Block("ds/τe, sum of vx", "M", lambda b: b.layers[1]),
    "layer_area": Block("ds², sum of disk area", "M", lambda b: b.layers[2]),
    "layer_stress": Block("m ds²/τe², sums of P_xx, P_xy, P_yy times volume by layer", "3 M", lambda b: b.layers[3:]),
    "pairs": Block("contacts in the samples", "", lambda b: b.looked[1]),
    "first": Block("sums of V_T, V^R, V^C_T, V_N over contacts, in ds γ̇", "4", lambda b: b.moments[0]),
    "second": Block("sums of their products", "4 4", lambda b: b.moments[1:]),
    "scatter": Block("the same for some contacts, one row each; NaN if there were fewer", "S 4", lambda b: b.scatter),
}


class Observed(dict[str, Any]):
    """Observables by name; a missing one is an error with its name."""

    def __missing__(self, name: str) -> Any:
        raise AbsentError(f"the run has no observable {name!r}: it was not recorded")


class AbsentError(InputError):
    """A run does not have an observable."""

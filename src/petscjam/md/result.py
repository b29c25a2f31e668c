"""The result of a sheared run: settings, time series, histograms and profiles, and the last state.

Axes: k row (an interval of the series), b block of rows, i disk.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, shown
from petscjam.base.files import (
    check_output,
    check_shapes,
    check_type,
    group,
    h5_format,
    marked,
    open_h5,
    write_atomically,
)
from petscjam.base.interrupt import check
from petscjam.base.tables import Table, Tabular, optional
from petscjam.base.types import Array
from petscjam.md.observables import BLOCKS, ROWS, AbsentError, Block, Observed, Row
from petscjam.md.settings import Settings
from petscjam.md.state import State

if TYPE_CHECKING:
    import h5py
    import xarray

FORMAT, SCHEMA = "petscjam run", 3  # 1 had neither parts nor other potentials; 1 and 2 had only squares
ARRAYS = ("positions", "velocities", "spins", "radii", "angles")  # of the state; angles may be absent
CELL = ("length", "height", "strain", "rate", "time")  # numbers of the state
MISSED = 0.01  # largest error of the energy budget, relative to the heat, without a warning
MIXED = ("tangential", "rotational", "contact", "normal")  # V_T, V^R, V^C_T, V_N of VOT eqs. 31–34
PARTS = ("elastic", "dissipative", "kinetic")  # of the pressure tensor
MEANS = {  # time means of properties of a run, for ``info``
    "P elastic": "pressure_elastic",
    "Σ elastic": "stress_elastic",
    "P": "pressure",
    "Σ": "stress",
    "μ": "friction",
    "ηp": "pressure_viscosity",
    "ησ": "viscosity",
    "Bp": "pressure_bagnold",
    "Bσ": "bagnold",
    "Z": "contacts",
    "Rv": "banding",
}


class Mean(NamedTuple):
    """A mean and its standard error."""

    value: float
    error: float


@dataclass(frozen=True, eq=False)
class Run(Tabular):
    """A sheared run. Units: ds, m, τe (VOT sec. II C).

    Attributes
    ----------
    settings : Settings
    rows : mapping of (K,) arrays
        One value for each interval: :data:`petscjam.md.observables.ROWS`. One that was not recorded is an
        AbsentError (InputError) with its name.
    blocks : mapping of arrays
        Sums over blocks of intervals: :data:`petscjam.md.observables.BLOCKS`; the first axis is the block.
    state : State
        At the end.
    """

    settings: Settings
    rows: Mapping[str, Array]
    blocks: Mapping[str, Array]
    state: State

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", Observed(self.rows))
        object.__setattr__(self, "blocks", Observed(self.blocks))

    @property
    def strain(self) -> Array:
        """γ at the end of each interval, (K,)."""
        return self.rows["strain"]

    @property
    def time(self) -> Array:
        """Time in τe, (K,)."""
        return self.rows["time"]

    @property
    def rate(self) -> Array:
        """Mean strain rate in 1/τe, (K,)."""
        return self.rows["rate"]

    @property
    def contacts(self) -> Array:
        """Z, mean contacts of a disk, (K,)."""
        return self.rows["contacts"]

    @property
    def pressure_elastic(self) -> Array:
        """P from elastic forces alone, in m/τe², (K,)."""
        return (self.rows["elastic_xx"] + self.rows["elastic_yy"]) / 2

    @property
    def stress_elastic(self) -> Array:
        """Σ from elastic forces alone, in m/τe², (K,)."""
        return -self.rows["elastic_xy"]

    @property
    def pressure(self) -> Array:
        """P of VOT eq. 18, (K,)."""
        return np.sum([self.rows[f"{part}_{x}{x}"] for part in PARTS for x in "xy"], axis=0) / 2

    @property
    def stress(self) -> Array:
        """Σ of VOT eq. 18, (K,)."""
        return -np.sum([self.rows[f"{part}_xy"] for part in PARTS], axis=0)

    @property
    def friction(self) -> Array:
        """μ = Σ/P, (K,)."""
        return self.stress / self.pressure

    @property
    def viscosity(self) -> Array:
        """ησ = QΣ/(γ̇τe) (VOT eq. 20, corrected), (K,)."""
        return self.settings.model.Q * self.stress / self.rate

    @property
    def pressure_viscosity(self) -> Array:
        """ηp = QP/(γ̇τe), (K,)."""
        return self.settings.model.Q * self.pressure / self.rate

    @property
    def bagnold(self) -> Array:
        """Bσ = Σ/(γ̇τe)² (VOT eq. 19), (K,)."""
        return self.stress / self.rate**2

    @property
    def pressure_bagnold(self) -> Array:
        """Bp = P/(γ̇τe)², (K,)."""
        return self.pressure / self.rate**2

    @property
    def banding(self) -> Array:
        """Rv = ⟨δvx²⟩/⟨vy²⟩ (VOT eq. 37), (K,)."""
        return self.rows["dvx2"] / self.rows["vy2"]

    def facts(self) -> dict[str, Any]:
        """Return the settings and the time means with their errors, by name."""
        s = self.settings
        facts: dict[str, Any] = {"model": s.model.name, "disks": s.particles, "phi": s.phi, "Q": s.model.Q}
        facts |= {"protocol": s.protocol, "strain": float(self.strain[-1]), "rows": len(self.strain)}
        with suppress(InputError):
            facts |= {
                name: f"{m.value:.4g} ± {m.error:.1g}" for name, m in self.means().items() if np.isfinite(m.value)
            }
        return facts

    def flat(self) -> Table:
        """Return a line for each interval of the time series."""
        return Table(dict(self.rows), {name: ROWS[name].unit for name in self.rows if name in ROWS})

    def to_xarray(self) -> xarray.Dataset:
        """Return time series and blocks as a Dataset of xarray, with units; the attributes are the settings.

        Raises
        ------
        MissingError
            Without xarray.
        """
        xr = optional("xarray", "tables")
        found: dict[str, Any] = {
            name: ("time", values, {"units": ROWS[name].unit if name in ROWS else ""})
            for name, values in self.rows.items()
        }
        for name, block in self.blocks.items():
            dims = ["block", *(f"{name}_{k}" for k in range(1, np.ndim(block)))]
            found[f"block_{name}"] = (dims, block, {"units": BLOCKS[name].unit if name in BLOCKS else ""})
        return xr.Dataset(found, attrs=dict(self.settings.attributes))

    def after(self, strain: float | None = None) -> NDArray[np.bool_]:
        """Mark the rows after ``strain`` from the start (default: 1/4 of the run), (K,) bool."""
        elapsed = np.diff(self.time, prepend=self.settings.time0)
        done = np.cumsum(np.abs(self.rate) * elapsed)
        return done > (done[-1] / 4 if strain is None else strain)

    def mean(self, values: str | ArrayLike, after: float | None = None) -> Mean:
        """Return the time mean of a row, or of a property, or of any (K,) ``values``, and its error.

        Parameters
        ----------
        values : str or (K,)
            As ``"pressure"`` or ``"elastic_xy"``.
        after : float
            Strain to leave out at the start; default: a quarter of the run.

        Raises
        ------
        InputError
            If fewer than two rows are left.
        """
        if isinstance(values, str):
            known = values not in self.rows and hasattr(Run, values)
            values = getattr(self, values) if known else self.rows[values]
        if np.shape(values) != self.strain.shape:
            shape = np.shape(values)
            raise InputError(f"mean: {len(self.strain)} values are needed, one for each row, not of shape {shape}")
        kept = np.asarray(values)[self.after(after)]
        if len(kept) < 2:
            raise InputError(f"mean: {len(kept)} of {len(self.strain)} rows are after a strain of {after}")
        return Mean(float(kept.mean()), blocked_error(kept))

    def means(self) -> dict[str, Mean]:
        """Return the time means for ``info``, by symbol, without those whose observables the run lacks.

        Raises
        ------
        InputError
            If the run has fewer than two rows after a quarter of it.
        """
        told = MEANS | {row.symbol: name for name, row in ROWS.items() if row.symbol}
        found: dict[str, Mean] = {}
        for symbol, name in told.items():
            with suppress(AbsentError), np.errstate(divide="ignore", invalid="ignore"):
                found[symbol] = self.mean(name)
        with suppress(AbsentError):
            found["<spin>/rate"] = self.mean(self.rows["spin"] / np.where(self.rate == 0, np.nan, self.rate))
        return found

    @property
    def missed(self) -> float:
        """Error of the energy budget relative to the heat: of the run, or after its first quarter if that is larger."""
        rounding = 1e-12 * np.abs(self.rows["energy"]).max(initial=0.0)
        shares = [0.0]
        for kept in (slice(None), self.after()):
            heat, missed = (abs(self.rows[name][kept].sum()) for name in ("heat", "imbalance"))
            if missed > rounding:
                shares.append(float(missed / heat) if heat else np.inf)
        return max(shares)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons why the numbers of the run may be inaccurate, one sentence each."""
        found, s = [], self.settings
        with suppress(AbsentError):
            if not self.missed <= MISSED:
                share = f"{100 * self.missed:.2g} %"
                found.append(f"the energy budget misses {share} of the heat: take a smaller dt")
        with suppress(AbsentError):
            parts = self.rows["parts"]
            if (parts > 1).any() and s.dt > s.model.step(None, s.integrator):
                found.append(
                    f"dt = {s.dt:.3g} is too large for the contacts in {(parts > 1).sum()} of {len(parts)} rows: "
                    f"time steps were divided into up to {parts.max():.0f} parts"
                )
        return tuple(found)


def blocked_error(values: ArrayLike) -> float:
    """Return the standard error of the mean of a correlated series, the largest over blockings.

    Values are averaged in pairs repeatedly (Flyvbjerg & Petersen 1989); each blocking with at least eight blocks
    gives an estimate.
    """
    x, worst = np.asarray(values, dtype=float), 0.0
    while len(x) >= 2:
        worst = max(worst, float(x.std(ddof=1) / len(x) ** 0.5))
        if len(x) < 16:
            break
        x = x[: len(x) // 2 * 2].reshape(-1, 2).mean(1)
    return worst


def is_run(path: str | PathLike[str]) -> bool:
    """Return whether ``path`` is a file of a run.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    return h5_format(path) == FORMAT


def write_run(h5: h5py.Group, run: Run) -> None:
    """Write ``run`` into an open HDF5 file.

    Parameters
    ----------
    h5 : h5py.File
    run : Run
    """
    h5.attrs.update(format=FORMAT, schema=SCHEMA)
    if run.warnings:
        h5.attrs["warnings"] = list(run.warnings)
    group(h5, "settings").attrs.update(run.settings.attributes)
    known: Mapping[str, Mapping[str, Row | Block]] = {"rows": ROWS, "blocks": BLOCKS}
    for where, values in (("rows", run.rows), ("blocks", run.blocks)):
        node = group(h5, where)
        for name, array in values.items():
            node[name] = array
            if name in known[where]:
                node[name].attrs["unit"] = known[where][name].unit
    node = group(h5, "state")
    for key in ARRAYS:
        if (values := getattr(run.state, key)) is not None:
            node[key] = values
    node.attrs.update({key: getattr(run.state, key) for key in CELL})


def read_run(h5: h5py.Group) -> Run:
    """Return the run of an open HDF5 file, with the observables that it has."""
    kind, schema = marked(h5)
    if kind != FORMAT or schema is None or schema not in range(1, SCHEMA + 1):
        raise InputError(f"holds {shown(kind)}, not a run with a schema up to {SCHEMA}")
    settings = Settings.from_attributes(h5["settings"].attrs)
    rows, blocks = _arrays(h5["rows"], ROWS), _arrays(h5["blocks"], BLOCKS)
    for name in ("time", "strain", "rate"):
        if name not in rows:
            raise InputError(f"rows: {name} is missing")
    older = {name: row.older for name, row in ROWS.items() if row.older is not None and name not in rows}
    rows |= {name: np.full(len(rows["time"]), value) for name, value in older.items()}
    check_arrays("rows", {name: "K" for name in rows}, rows)
    check_arrays("blocks", {name: f"B {BLOCKS[name].shape}" for name in blocks if name in BLOCKS}, blocks, {"scatter"})
    node, numbers = h5["state"], dict(h5["state"].attrs)
    arrays = {key: node[key][()] for key in ARRAYS if key != "angles" or key in node}
    if schema < 3:
        numbers["height"] = numbers["length"]
    state = State(**arrays, **{key: numbers[key] for key in CELL}, potential_name=settings.model.potential.name)
    return Run(settings, rows, blocks, state)


def _arrays(node: h5py.Group, known: Mapping[str, Any]) -> dict[str, Array]:
    """Return the arrays of a group, known ones first, in their order."""
    names = [*(name for name in known if name in node), *(name for name in node if name not in known)]
    return {name: node[name][()] for name in names}


def check_arrays(
    where: str,
    shapes: Mapping[str, str],
    values: Mapping[str, Array],
    holes: Container[str] = (),
    whole: Container[str] = (),
) -> None:
    """Refuse arrays from a file that are not those of a run.

    Parameters
    ----------
    where : str
        Their name in a message.
    shapes : mapping
        Axes of each (:func:`petscjam.base.files.check_shapes`).
    values : mapping
        The arrays.
    holes, whole : container of str
        Those that may have NaN; and those of integers.

    Raises
    ------
    InputError
        If one is missing, or has another type or shape, or a number is not finite.
    """
    for name in shapes:
        if name not in values:
            raise InputError(f"{where}: {name} is missing")
        check_type(f"{where}: {name}", values[name], "Integers" if name in whole else "Array")
        if name not in holes and not np.isfinite(values[name]).all():
            raise InputError(f"{where}: {name} is not finite")
    check_shapes(where, shapes, values)


def read(path: str | PathLike[str]) -> Run:
    """Return the run of a file that :func:`petscjam.md.shear` or ``petscjam shear`` wrote; of a folder all, by name.

    :func:`read_folder` has the type of the latter.

    Raises
    ------
    InputError
        If the file is missing, damaged or truncated, or holds no run.
    """
    if Path(path).is_dir():
        return read_folder(path)  # type: ignore[return-value]
    with open_h5(path) as h5:
        return read_run(h5)


def read_folder(folder: str | PathLike[str]) -> dict[str, Run]:
    """Return every run in ``folder`` by the name of its file, without the extension.

    Raises
    ------
    InputError
        If there is none.
    """
    runs = {}
    for file in sorted(Path(folder).glob("*.h5")):
        check()
        if is_run(file):
            runs[file.stem] = read(file)
    if not runs:
        raise InputError(f"{folder}: there are no runs in this folder")
    return runs


def export_csv(run: Run, path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Write the time series as CSV, a column for each of its observables; the first line has model and potential.

    Parameters
    ----------
    run : Run
    path : path
    overwrite : bool
        Replace the file.

    Raises
    ------
    InputError
        If the file cannot be written, or exists.
    """
    check_output(path, overwrite=overwrite)
    table = np.column_stack(list(run.rows.values()))
    model = run.settings.model
    lines = [f"# {model.name}, {model.potential.name}, Q = {model.Q:g}"]
    lines += [f"# {name}: {ROWS[name].unit}" for name in run.rows if name in ROWS]
    lines += [",".join(run.rows), *(",".join(f"{x:.16e}" for x in row) for row in table)]
    write_atomically(path, "\n".join([*lines, ""]).encode())

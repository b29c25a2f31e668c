"""What a sheared run leaves: its settings, its time series, its histograms and profiles, and its last state.

Axes: k row (an interval of the series), b block of rows, i disk.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError, shown
from petscjam.base.files import check_output, check_shapes, check_type, group, h5_format, open_h5, write_atomically
from petscjam.base.types import Array
from petscjam.geometry.potential import power_law
from petscjam.md.model import model_of
from petscjam.md.state import State

FORMAT, SCHEMA = "petscjam run", 2  # schema 1 knew neither parts nor other potentials
MISSED = 0.01  # share of the heat that the energy budget may miss without a warning
BINS = 100  # of the collision angle, 3.6° each (VOT fig. 8)
MIXED = ("tangential", "rotational", "contact", "normal")  # V_T, V^R, V^C_T, V_N of VOT eqs. 31–34

# Means over an interval unless said otherwise. The pressure tensor is VOT's eqs. 12–14: first index force or
# velocity, second index separation; dissipative_yx is listed since model CD makes it differ from _xy.
ROWS = {
    "time": "τe, at the end of the interval",
    "strain": "at the end",
    "rate": "1/τe",
    "elastic_xx": "m/τe²",
    "elastic_xy": "m/τe²",
    "elastic_yy": "m/τe²",
    "dissipative_xx": "m/τe²",
    "dissipative_xy": "m/τe²",
    "dissipative_yx": "m/τe²",
    "dissipative_yy": "m/τe²",
    "kinetic_xx": "m/τe²",
    "kinetic_xy": "m/τe²",
    "kinetic_yy": "m/τe²",
    "contacts": "Z",
    "energy": "m ds²/τe², at the end: elastic, peculiar kinetic and rotational",
    "work": "m ds²/τe² done by the shear stress in the interval",
    "jumps": "m ds²/τe² brought by sudden changes of the strain rate",
    "heat": "m ds²/τe² dissipated in the interval",
    "imbalance": "m ds²/τe², change of energy − work − jumps + heat: what the budget misses",
    "made": "contacts made in the interval",
    "broken": "contacts broken",
    "duration": "τe, sum over the contacts broken",
    "spin": "1/τe, mean θ̇",
    "spin_variance": "1/τe², over disks and time",
    "dvx2": "ds²/τe² (VOT eq. 35)",
    "vy2": "ds²/τe² (VOT eq. 36)",
    "normal2": "ds²/τe², mean square normal velocity of contacts",
    "tangential2": "ds²/τe²",
    "steps": "time steps, each part counted",
    "parts": "most parts that a time step dt was divided into",
    "rebuilds": "neighbour lists built",
}
# Sums over a block; M is the number of layers in y, each about ds high.
BLOCKS = {
    "strain": "(B,) at the end of the block",
    "samples": "(B,) moments at which disks and contacts were looked at",
    "making": "(B, 100) contacts made by collision angle ϑ, from −180°",
    "breaking": "(B, 100)",
    "layer_disks": "(B, M) disks by layer",
    "layer_vx": "(B, M) ds/τe, sum of vx",
    "layer_area": "(B, M) ds², sum of disk area",
    "pairs": "(B,) contacts looked at",
    "first": "(B, 4) sums of V_T, V^R, V^C_T, V_N over contacts, in ds γ̇",
    "second": "(B, 4, 4) sums of their products",
    "scatter": "(B, S, 4) some of them, one row a contact, NaN where there were fewer",
}


SHAPES = {
    "strain": "B",
    "samples": "B",
    "making": f"B {BINS}",
    "breaking": f"B {BINS}",
    "layer_disks": "B M",
    "layer_vx": "B M",
    "layer_area": "B M",
    "pairs": "B",
    "first": "B 4",
    "second": "B 4 4",
    "scatter": "B S 4",
}
CHECKPOINT = {
    "q": "N 5",
    "radii": "N",
    "masses": "N",
    "tag": "N",
    "contacts": "C 3",
    "numbers": "5",
    "counts": "2",
    "start": "T",
    "block_angles": f"2 {BINS}",
    "block_layers": "3 M",
    "block_moments": "5 4",
    "block_scatter": "S 4",
    "block_looked": "2",
}
SETTINGS = {  # without which a run cannot be read
    "model": "str",
    "law": "str",
    "Q": "float",
    "protocol": "str",
    "dt": "float",
    "integrator": "str",
    "potential": "str",
    "particles": "int",
    "phi": "float",
    "start": "str",
    "strain0": "float",
    "time0": "float",
}


class Mean(NamedTuple):
    """A mean and its standard error."""

    value: float
    error: float


@dataclass(frozen=True, eq=False)
class Run:
    """A sheared run. Units: ds, m, τe (VOT sec. II C).

    Attributes
    ----------
    settings : mapping
        model, law, Q, potential, drag, spin_drag, particles, phi, protocol, rate, dt, integrator, …
    rows : mapping of (K,) arrays
        One value an interval: :data:`ROWS`.
    blocks : mapping of arrays
        Sums over blocks of intervals: :data:`BLOCKS`.
    state : State
        At the end.
    """

    settings: Mapping[str, Any]
    rows: Mapping[str, Array]
    blocks: Mapping[str, Array]
    state: State

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
        return self.settings["Q"] * self.stress / self.rate

    @property
    def pressure_viscosity(self) -> Array:
        """ηp = QP/(γ̇τe), (K,)."""
        return self.settings["Q"] * self.pressure / self.rate

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

    def after(self, strain: float | None = None) -> np.ndarray:
        """Return which rows lie beyond ``strain`` from the start, (K,) bool; left out, 1/4 of the run."""
        elapsed = np.diff(self.time, prepend=self.settings["time0"])
        done = np.cumsum(np.abs(self.rate) * elapsed)
        return done > (done[-1] / 4 if strain is None else strain)

    def mean(self, values: str | ArrayLike, after: float | None = None) -> Mean:
        """Return the time mean of a row, or of a property, or of any (K,) ``values``, and its error.

        Parameters
        ----------
        values : str or (K,)
            As ``"pressure"`` or ``"elastic_xy"``.
        after : float
            Strain to leave out at the start; left out, a quarter of the run.

        Raises
        ------
        InputError
            If fewer than two rows are left.
        """
        if isinstance(values, str):
            values = self.rows[values] if values in self.rows else getattr(self, values)
        kept = np.asarray(values)[self.after(after)]
        if len(kept) < 2:
            raise InputError(f"mean: {len(kept)} of {len(self.strain)} rows lie after a strain of {after}")
        return Mean(float(kept.mean()), blocked_error(kept))

    @property
    def missed(self) -> float:
        """Share of the heat that the energy budget misses: in the run, or after a quarter if that is more."""
        rounding = 1e-12 * np.abs(self.rows["energy"]).max(initial=0.0)
        shares = [0.0]
        for kept in (slice(None), self.after()):
            heat, missed = (abs(self.rows[name][kept].sum()) for name in ("heat", "imbalance"))
            if missed > rounding:
                shares.append(float(missed / heat) if heat else np.inf)
        return max(shares)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the numbers of the run doubtful, a sentence each."""
        found, s = [], self.settings
        if not self.missed <= MISSED:
            share = f"{100 * self.missed:.2g} %"
            found.append(f"the energy budget misses {share} of the heat: take a smaller dt")
        divided = self.rows["parts"] > 1
        if divided.any() and s["dt"] > model_of(s).step(None, s["integrator"]):
            where = f"too large for the contacts in {divided.sum()} of {len(divided)} rows"
            parts = f"time steps were divided into up to {self.rows['parts'].max():.0f} parts"
            found.append(f"dt = {s['dt']:.3g} is {where}: {parts}")
        return tuple(found)


PARTS = ("elastic", "dissipative", "kinetic")


def blocked_error(values: ArrayLike) -> float:
    """Return the standard error of the mean of a correlated series, the largest over blockings.

    Values are averaged in pairs again and again (Flyvbjerg & Petersen 1989); each blocking with at least
    eight blocks gives an estimate.
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


def write_run(h5: Any, run: Run) -> None:
    """Write ``run`` into an open HDF5 file."""
    h5.attrs.update(format=FORMAT, schema=SCHEMA)
    if run.warnings:
        h5.attrs["warnings"] = list(run.warnings)
    group(h5, "settings").attrs.update({k: v for k, v in run.settings.items() if v is not None})
    for name, units, values in (("rows", ROWS, run.rows), ("blocks", BLOCKS, run.blocks)):
        node = group(h5, name)
        for key, array in values.items():
            node[key] = array
            node[key].attrs["unit"] = units[key]
    node = group(h5, "state")
    for key in ("positions", "velocities", "spins", "radii"):
        node[key] = getattr(run.state, key)
    node.attrs.update({key: getattr(run.state, key) for key in ("length", "strain", "rate", "time")})


def read_run(h5: Any) -> Run:
    """Return the run of an open HDF5 file."""
    if h5.attrs.get("format") != FORMAT or h5.attrs.get("schema") not in (1, SCHEMA):
        raise InputError(f"holds {shown(h5.attrs.get('format'))}, not a run with schema {SCHEMA}")
    settings = {k: v.item() if isinstance(v, np.generic) else v for k, v in h5["settings"].attrs.items()}
    old = h5.attrs["schema"] == 1
    rows = {key: h5["rows"][key][()] for key in ROWS if not (old and key == "parts")}
    if old:
        rows["parts"] = np.ones_like(rows["steps"])
        settings["potential"] = power_law(settings.pop("exponent"), relative=True).name
    blocks = {key: h5["blocks"][key][()] for key in BLOCKS}
    _check(settings, rows, blocks)
    node = h5["state"]
    arrays = {key: node[key][()] for key in ("positions", "velocities", "spins", "radii")}
    state = State(**arrays, **dict(node.attrs), potential_name=settings["potential"])
    return Run(settings, rows, blocks, state)


def _check(settings: Mapping[str, Any], rows: Mapping[str, Array], blocks: Mapping[str, Array]) -> None:
    for name, annotation in SETTINGS.items():
        if name not in settings:
            raise InputError(f"settings: {name} is missing")
        check_type(f"settings: {name}", settings[name], annotation)
    for where, values in (("rows", rows), ("blocks", blocks)):
        for name, value in values.items():
            check_type(f"{where}: {name}", value, "Array")
            if name != "scatter" and not np.isfinite(value).all():
                raise InputError(f"{where}: {name} is not finite")
    check_shapes("rows", dict.fromkeys(rows, "K"), rows)
    check_shapes("blocks", SHAPES, blocks)


def read_checkpoint(h5: Any) -> dict[str, Any]:
    """Return what a run needs to go on (:meth:`petscjam.md.recording.Book.write`) from an open HDF5 file."""
    saved = {name: h5["checkpoint"][name][()] for name in h5["checkpoint"]}
    check_shapes("checkpoint", CHECKPOINT, saved)
    whole = {"tag", "contacts", "counts", "block_angles"}
    if saved["block_looked"].dtype.kind == "i":  # floats in older files, unless a block had just been closed
        whole.add("block_looked")
    for name in CHECKPOINT:
        kind = "Integers" if name in whole else "Array"
        check_type(f"checkpoint: {name}", saved[name], kind)
        if name != "block_scatter" and not np.isfinite(saved[name]).all():
            raise InputError(f"checkpoint: {name} is not finite")
    disks, tags = saved["contacts"][:, :2], np.arange(len(saved["tag"]))
    if not (np.array_equal(np.sort(saved["tag"]), tags) and np.isin(disks, tags).all()):
        raise InputError("checkpoint: tag or contacts name disks that there are not")
    return saved


def read(path: str | PathLike[str]) -> Run:
    """Return the run of a file that :func:`petscjam.md.shear` or ``petscjam shear`` wrote.

    Raises
    ------
    InputError
        If the file is missing, damaged or truncated, or holds no run.
    """
    with open_h5(path) as h5:
        return read_run(h5)


def read_folder(folder: str | PathLike[str]) -> dict[str, Run]:
    """Return every run in ``folder`` by the name of its file, without the ending."""
    files = sorted(Path(folder).glob("*.h5"))
    return {file.stem: read(file) for file in files if is_run(file)}


def export_csv(run: Run, path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Write the time series as CSV, a column for each of :data:`ROWS`."""
    check_output(path, overwrite=overwrite)
    table = np.column_stack([run.rows[name] for name in ROWS])
    lines = [f"# {name}: {text}" for name, text in ROWS.items()]
    lines += [",".join(ROWS), *(",".join(f"{x:.16e}" for x in row) for row in table)]
    write_atomically(path, "\n".join([*lines, ""]).encode())

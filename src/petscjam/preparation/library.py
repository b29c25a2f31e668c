"""Libraries: folders of packings of several sizes, pressures and seeds, made by one recipe.

A folder contains one file for each packing; ``library.json``, the recipe; and ``index.csv``, a line for each
packing and for each failure, with the computing time. A line that is lost or damaged is written again from the
packing, without its time.
"""

from __future__ import annotations

import csv
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from hashlib import blake2b
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from petscjam.base.arguments import parsed, parsed_whole
from petscjam.base.errors import InputError, SolverError, shown
from petscjam.base.files import check_output, check_type, naming, open_h5, understanding, write_atomically
from petscjam.base.interrupt import Interrupted, deferred
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.ranges import MOST_RUNS
from petscjam.base.tables import Table, Tabular
from petscjam.base.types import numbers
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.geometry.packing_file import OURS
from petscjam.parallel.claims import claimed, made_folder
from petscjam.parallel.comm import Comm, agree, on_root, raise_together, resolve
from petscjam.parallel.teams import cores_each, teams
from petscjam.preparation.prepare import BUDGET, check, prepare_packing, relax_packing

SCHEMA = 1
RECIPE, INDEX = "library.json", "index.csv"
COLUMNS = (
    "file",
    "particles",
    "target",
    "seed",
    "potential",
    "phi",
    "pressure",
    "Z",
    "rattlers",
    "contacts",
    "lowest_eigenvalue",
    "shear_modulus",
    "max_force",
    "proved",
    "checksum",
    "seconds",
    "failure",
)
WORTH_THREADS = 10_000  # disks


@dataclass(frozen=True)
class Recipe:
    """The common settings of the packings of a library; all except ``decompress`` as in :func:`prepare_packing`.

    Parameters
    ----------
    decompress : bool
        Whether the packings of one size and seed are a series: the one of the highest pressure has a random
        start, each other one starts from the one before it.
    """

    shear_stabilised: bool = False
    decompress: bool = False
    method: str = "fire"
    potential_name: str = "harmonic"
    ratio: float = 1.4
    composition: float = 0.5
    polydispersity: float = 0.0

    @property
    def start(self) -> dict[str, Any]:
        """The arguments of :func:`prepare_packing`."""
        return {name: value for name, value in asdict(self).items() if name != "decompress"}


@dataclass(frozen=True)
class Library(Tabular):
    """The content of a folder of packings.

    Attributes
    ----------
    folder : Path
    recipe : mapping
        Settings by name; empty if the folder was not made by :func:`prepare_library`.
    rows : list of dicts
        For each packing: ``file``, ``particles``, ``target`` (target pressure), ``seed``, ``potential``,
        ``phi``, ``pressure``, ``Z``, ``rattlers``, ``contacts``, ``lowest_eigenvalue``, ``shear_modulus`` (the
        lowest over all directions), ``max_force``, ``proved``, ``checksum``, ``seconds``; None: unknown.
    failed : list of dicts
        For each packing that failed: ``file``, ``particles``, ``target``, ``seed``,
        ``seconds``, ``failure``, the reason.
    tried : set of strings
        The files that :func:`prepare_library` tried to make.
    """

    folder: Path
    recipe: Mapping[str, Any]
    rows: list[dict[str, Any]]
    failed: list[dict[str, Any]]
    tried: frozenset[str] = frozenset()

    def facts(self) -> dict[str, Any]:
        """Return the number of packings, of proved minima and of failures, the sizes and pressures, by name."""
        sizes = sorted({row["particles"] for row in self.rows})
        targets = sorted({row["target"] or row["pressure"] for row in self.rows})
        return {
            "folder": self.folder,
            "packings": len(self.rows),
            "proved minima": sum(row["proved"] is True for row in self.rows),
            "failed": len(self.failed),
            "disks": ", ".join(map(str, sizes)),
            "pressures": ", ".join(f"{p:.3g}" for p in targets),
        }

    def flat(self) -> Table:
        """Return a line for each packing, and for each one that failed."""
        units = dict.fromkeys(("target", "pressure", "shear_modulus"), "k") | {"lowest_eigenvalue": "k", "seconds": "s"}
        return Table.of_rows([*self.rows, *self.failed], units)


@dataclass(frozen=True)
class _Series:
    """Packings that are made one after the other: a series of pressures, or a single one."""

    n: int
    seed: int
    pressures: tuple[float, ...]

    def names(self) -> Iterator[tuple[float, str]]:
        """Pressures and names of files."""
        for pressure in self.pressures:
            yield pressure, f"N{self.n}_p{pressure:g}_s{self.seed:04d}.h5"

    def cost(self, pressure: float) -> float:
        """Computing time, in any unit."""
        return self.n * pressure**-0.3


@reporting
@deferred()
def prepare_library(
    folder: str | PathLike[str],
    particles: int | Iterable[int] = (1024,),
    pressures: ArrayLike = (1e-3,),
    seeds: int | Iterable[int] = (1,),
    *,
    comm: Comm | None = None,
    resume: bool = False,
    overwrite: bool = False,
    threads: int | None = None,
    budget: int = BUDGET,
    progress: Progress | None = None,
    **recipe: Any,
) -> Library:
    """Prepare a packing of every size, pressure and seed in ``folder``, and return its content.

    Each is made by one rank, and does not depend on the number of ranks. If one fails, the others continue; it is
    in ``failed`` of the library, and tried again with ``resume``.

    Parameters
    ----------
    folder : path
        Made if it does not exist. Existing packings in it must have the same recipe.
    particles, pressures, seeds : numbers, or iterables of them
        As ``n``, ``pressure`` and ``seed`` of :func:`prepare_packing`; pressures have twelve digits.
    comm : communicator
    resume : bool
        Keep existing packings; else they are an error, unless ``overwrite``.
    threads : int, optional
        For each rank. Default: its share of the cores if the packings are large and few, else 1.
    budget : int
        Evaluations of the force, for each packing.
    progress : callable, optional
        As in :func:`prepare_packing`; the fraction is that of the work of the rank.
    **recipe
        The fields of :class:`Recipe`.

    Raises
    ------
    InputError
        On an argument out of range, if a packing exists, or is of another recipe, or cannot be written.
    """
    comm, folder = resolve(comm), Path(folder)
    particles, seeds, goals = _listed(particles), _listed(seeds), numbers("pressures", pressures).tolist()
    agree(comm, folder, particles, goals, seeds, resume, overwrite, budget, sorted(recipe.items()))
    settings = Recipe(**recipe)
    series = _planned(particles, goals, seeds, settings, budget)
    with made_folder(folder, comm), claimed(folder, comm):
        missing = on_root(comm, _opened, folder, series, settings, resume, overwrite)
        _fill(folder, series, settings, missing, comm, threads, budget, progress)
        return replace(on_root(comm, read_library, folder), tried=frozenset(missing))


def _fill(
    folder: Path,
    series: list[_Series],
    settings: Recipe,
    missing: set[str],
    comm: Comm,
    threads: int | None,
    budget: int,
    progress: Report | None,
) -> None:
    """Make missing packings, each series by one rank."""
    todo = [s for s in series if any(name in missing for _, name in s.names())]
    threads = threads or threads_for([s.n for s in todo], comm)

    def work(s: _Series) -> float:
        return sum(s.cost(pressure) for pressure, name in s.names() if name in missing)

    error: Exception | Interrupted | None = None
    with teams(comm) as team:
        mine = team.deal(todo, work)
        done, everything = 0.0, sum(map(work, mine))
        try:
            for s in mine:
                report = _share(progress, done / everything, work(s) / everything)
                _make(folder, s, settings, missing, report, threads=threads, budget=budget)
                done += work(s)
        except (Exception, Interrupted) as caught:  # for instance a full disk: on this rank only
            error = caught
    raise_together(comm, error)


def threads_for(sizes: Sequence[int], comm: Comm) -> int:
    """Return the threads of each rank: its cores, if the tasks are large and few, else 1.

    Parameters
    ----------
    sizes : sequence of int
        Disks of each task.
    comm : communicator
    """
    large = len(sizes) <= comm.size and max(sizes, default=0) >= WORTH_THREADS
    return cores_each(comm) if large else 1


def read_library(folder: str | PathLike[str]) -> Library:
    """Read a folder of packings, made by :func:`prepare_library` or not.

    Raises
    ------
    InputError
        If there are no packings, one cannot be read, or potentials or units of length differ.
    """
    library = _read(Path(folder))
    if not library.rows and not library.failed:
        raise InputError(f"{folder}: no packings in this folder")
    return library


def exists(file: Path, n: int, pressure: float, seed: int, recipe: Recipe, before: Sequence[float] = ()) -> bool:
    """Return whether the packing exists.

    Parameters
    ----------
    file : Path
    n, pressure, seed
        As for :func:`prepare_packing`.
    recipe : Recipe
    before : sequence of float
        Pressures of the packings before it in a decompressed series.

    Raises
    ------
    InputError
        If ``file`` is another packing.
    """
    if not file.exists():
        return False
    packing = Packing.read(file)
    there = {**packing.provenance, "potential_name": packing.potential_name}
    wanted = {"n": n, "pressure": pressure, "seed": seed, **recipe.start}
    wanted["decompressed_from"] = list(before) if recipe.decompress else None
    for key, value in wanted.items():
        if there.get(key) != value:
            raise InputError(f"{file}: has {key} = {there.get(key)}, not {value}; it cannot be resumed")
    return True


def _planned(
    particles: Sequence[int], pressures: Iterable[float], seeds: Sequence[int], recipe: Recipe, budget: int
) -> list[_Series]:
    pressures = sorted((float(f"{float(p):.12g}") for p in pressures), reverse=True)
    groups = [tuple(pressures)] if recipe.decompress else [(pressure,) for pressure in pressures]
    count = len(particles) * len(pressures) * len(seeds)
    if count > MOST_RUNS:
        raise InputError(f"prepare: {count} packings; at most {MOST_RUNS:.0g} at once")
    series = [_Series(n, seed, group) for n in particles for group in groups for seed in seeds]
    names: dict[str, tuple[int, float, int]] = {}
    for s in series:
        for pressure in s.pressures:
            check(s.n, pressure, s.seed, budget=budget, **recipe.start)
        for pressure, name in s.names():
            if name in names:
                both = f"{shown(names[name])} and {shown((s.n, pressure, s.seed))}"
                raise InputError(f"prepare: (particles, pressure, seed) = {both} are the same packing, {name}")
            names[name] = s.n, pressure, s.seed
    if not names:
        raise InputError("prepare: there is nothing to prepare without a size, a pressure and a seed")
    return series


def _listed(values: int | Iterable[int]) -> list[int]:
    return list(values) if isinstance(values, Iterable) else [values]


def _opened(folder: Path, series: list[_Series], recipe: Recipe, resume: bool, overwrite: bool) -> set[str]:
    """Write recipe and index, after all checks; return the missing packings."""
    library = _read(folder, recipe)
    missing = set()
    for s in series:
        for pressure, name in s.names():
            before = [p for p in s.pressures if p > pressure]
            if overwrite or not (resume and exists(folder / name, s.n, pressure, s.seed, recipe, before)):
                check_output(folder / name, overwrite=overwrite)
                missing.add(name)
    for file in folder.glob(".*.part"):  # incomplete, from a run that was killed
        if file.name[1:].rsplit(".", 2)[0] in {*missing, RECIPE, INDEX}:
            with suppress(OSError):
                file.unlink()
    if not library.recipe:
        content = {"schema": SCHEMA, "units": "stiffness k = 1, mean diameter d = 1"}
        content |= {"recipe": asdict(recipe), "checksum": _checksum(asdict(recipe))}
        write_atomically(folder / RECIPE, f"{json.dumps(content, indent=2)}\n".encode())
    lines = [dict(zip(COLUMNS, COLUMNS, strict=True)), *library.rows, *library.failed]
    write_atomically(folder / INDEX, "".join(map(_line, lines)).encode(errors="surrogateescape"))
    return missing


def _make(folder: Path, s: _Series, recipe: Recipe, missing: set[str], progress: Report | None, **options: Any) -> None:
    """Make the missing packings of a series; the packing before, to decompress, is read from its file."""
    before: list[float] = []
    last: Path | None = None
    failure = ""
    for k, (pressure, name) in enumerate(s.names()):
        file, start = folder / name, time.perf_counter()
        if name not in missing:
            failure = ""
        else:
            report = _share(progress, k / len(s.pressures), 1 / len(s.pressures), f"{file.stem}: ")
            try:
                if failure:
                    raise SolverError(failure)
                if last is None:
                    packing = prepare_packing(s.n, pressure, s.seed, **recipe.start, **options, progress=report)
                else:
                    packing = relax_packing(
                        Packing.read(last),
                        pressure,
                        shear_stabilised=recipe.shear_stabilised,
                        method=recipe.method,
                        **options,
                        progress=report,
                    )
            except Exception as error:
                ours = isinstance(error, InputError | SolverError)
                reason = str(error) if ours else f"{type(error).__name__}: {error}"
                row = {"file": name, "particles": s.n, "target": pressure, "seed": s.seed}
                row["failure"] = " ".join(reason.split())
                failure = f"{name}, to start from, failed"
            else:
                if recipe.decompress:
                    made_by = {**packing.provenance, "decompressed_from": before}
                    packing = replace(packing, provenance=made_by)
                packing.write(file, overwrite=True)
                row = _row(name, packing)
            row["seconds"] = round(time.perf_counter() - start, 3)
            _append(folder / INDEX, row)
        before, last = [*before, pressure], file


def _share(progress: Report | None, start: float, part: float, label: str = "") -> Report | None:
    """Return the progress function of a part of the work."""
    if progress is None:
        return None
    return lambda fraction, text: progress(start + fraction * part, label + text)


def _read(folder: Path, recipe: Recipe | None = None) -> Library:
    """Read a folder; given a recipe, refuse another one."""
    with naming(folder):
        files = sorted(file for file in folder.iterdir() if file.suffix == ".h5" and file.name[0] != ".")
    known, logged = _recipe(folder / RECIPE), _logged(folder / INDEX)
    for key, value in asdict(recipe).items() if recipe and known else ():
        if known.get(key) != value:
            raise InputError(
                f"{folder}: has packings with {key} = {known.get(key)}, not {value}; choose another folder"
            )
    kinds, rows = {}, []
    if recipe:
        kinds[(recipe.potential_name, 1.0)] = RECIPE
    for file in files:
        with open_h5(file) as h5:
            if OURS not in h5:  # results may be in the same folder
                continue
        packing = Packing.read(file)
        kinds.setdefault(_kind(packing), file.name)
        with naming(file):
            row = _row(file.name, packing)
        line = logged.pop(file.name, {})
        if line.get("checksum") == row["checksum"]:
            row["seconds"] = _number(line["seconds"])
        rows.append(row)
    _check_units(folder, kinds)
    failed = [_failed(line) for _, line in sorted(logged.items()) if line["failure"]]
    return Library(folder, known, rows, [row for row in failed if row])


def _recipe(file: Path) -> dict[str, Any]:
    if not file.exists():
        return {}
    with naming(file):
        with understanding("recipe of a library"):
            content = json.loads(file.read_text(encoding="utf-8"))
            schema, recipe = content["schema"], dict(content["recipe"])
            if not isinstance(schema, int):
                raise InputError(f"the schema is {shown(schema)}, not a whole number")
            there, made = content.get("checksum"), _checksum(recipe)
        if schema > SCHEMA:
            raise InputError(f"written by a newer petscjam (schema {schema}; this reads {SCHEMA})")
        if there not in (None, made):  # None: of an older petscjam
            raise InputError(f"the checksum is {made} but {shown(there)} was recorded; it was changed or damaged")
        for item in fields(Recipe):
            if item.name not in recipe:
                raise InputError(f"the recipe lacks {item.name}")
            check_type(item.name, recipe[item.name], str(item.type))
    return recipe


def _checksum(recipe: Mapping[str, Any]) -> str:
    return blake2b(json.dumps(recipe).encode(), digest_size=8).hexdigest()


def _logged(file: Path) -> dict[str, dict[str, str]]:
    """Return the complete lines of the index by file; of several the last is valid."""
    if not file.exists():
        return {}
    with naming(file):
        text = file.read_bytes().decode(errors="surrogateescape").replace("\0", "")
    lines = [next(csv.reader([line]), []) for line in text.splitlines()[1:]]
    return {line[0]: dict(zip(COLUMNS, line, strict=True)) for line in lines if len(line) == len(COLUMNS)}


def _kind(packing: Packing) -> tuple[str, float]:
    """Return what determines the units: the potential and, except for fluctuations, the mean diameter."""
    ours = packing.provenance.get("program") == "petscjam"
    return packing.potential_name, 1.0 if ours else packing.mean_diameter


def _check_units(folder: Path, kinds: dict[tuple[str, float], str]) -> None:
    (potential, diameter), first = next(iter(kinds.items()), (("", 1.0), ""))
    for (other, width), file in kinds.items():
        if other != potential:
            what = f"the potential of {first} is {potential}, that of {file} {other}"
        elif not 0.8 < width / diameter < 1.25:  # a few polydisperse disks
            what = f"the mean diameter of {first} is {diameter:.4g}, that of {file} {width:.4g}"
        else:
            continue
        raise InputError(f"{folder}: mixed units: {what}; keep them in different folders")


def _row(name: str, packing: Packing) -> dict[str, Any]:
    made_by, c = packing.provenance, packing.certificate
    measured = {name: getattr(c, name) for name in ("pressure", "Z", "rattlers", "contacts")}
    if None in measured.values():
        network = ContactNetwork.of(packing)
        # A packing that is not jammed may have none.
        contacts = int((network.backbone[network.i] & network.backbone[network.j]).sum())
        measured = {"pressure": network.pressure, "Z": network.Z, "rattlers": network.rattlers, "contacts": contacts}
    return {
        "file": name,
        "particles": len(packing),
        "target": _if_number(made_by.get("pressure")),
        "seed": _if_number(made_by.get("seed")),
        "potential": packing.potential_name,
        "phi": packing.phi,
        **measured,
        "lowest_eigenvalue": c.lowest_eigenvalue,
        "shear_modulus": c.shear_modulus,
        "max_force": c.max_force,
        "proved": c.proved,
        "checksum": packing.checksum,
        "seconds": None,
    }


def _if_number(value: Any) -> Any:
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def _failed(line: Mapping[str, str]) -> dict[str, Any]:
    try:
        return {
            "file": line["file"],
            "particles": parsed_whole(line["particles"]),
            "target": parsed(line["target"]),
            "seed": parsed_whole(line["seed"]),
            "seconds": _number(line["seconds"]),
            "failure": line["failure"],
        }
    except ValueError:  # damaged
        return {}


def _number(text: str) -> float | None:
    try:
        return parsed(text)
    except ValueError:
        return None


def _line(row: Mapping[str, Any]) -> str:
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerow([row.get(name) for name in COLUMNS])
    return text.getvalue()


def _append(file: Path, row: Mapping[str, Any]) -> None:
    """Append a line with one call, so that lines of several ranks do not mix."""
    with naming(file):
        index = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(index, _line(row).encode(errors="surrogateescape"))
        finally:
            os.close(index)

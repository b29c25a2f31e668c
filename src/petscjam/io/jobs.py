"""Analyses of many packings × laws × pre-stress, distributed over teams of ranks; each result is stored at once."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError, readable
from petscjam.base.files import check_output, naming
from petscjam.base.interrupt import deferred
from petscjam.base.progress import Report
from petscjam.geometry.packing import Packing
from petscjam.io.importers import import_packing
from petscjam.io.results import append_result, done, group_name, inventory, run_of
from petscjam.parallel.claims import claimed, turn
from petscjam.parallel.comm import Comm, agree, on_root
from petscjam.parallel.memory import available_memory, factor_memory
from petscjam.parallel.teams import Team, deal
from petscjam.response.family import LARGEST_BETA, beta_family
from petscjam.response.moduli import complex_modulus
from petscjam.response.origin import Result
from petscjam.response.reduced import spectrum
from petscjam.response.result import ComplexModulus
from petscjam.rows.damping import ContactDamping, DampingLaw, StokesDrag
from petscjam.rows.kinematics import strain_mode

LARGE = 20_000  # number of disks from which on the memory of a factor is printed
Made = set[tuple[str, str, bool]]  # checksum, law and pre-stress of each result in a file


@dataclass(frozen=True)
class Ensemble:
    """Packings, laws and pre-stress whose results go to one file, and how it is written.

    Attributes
    ----------
    files : sequence of Path
        Of packings.
    output : path
        Of the results.
    laws : sequence of DampingLaw or None
        None for an analysis without a damping law.
    prestress : sequence of bool
    team_size : int, optional
        Ranks that work together on one packing. Default: one, or more if there are fewer jobs than ranks or the
        factors do not fit into memory.
    resume : bool
        Keep the results in ``output``, and compute the missing ones.
    overwrite : bool
        Replace ``output``.
    """

    files: Sequence[Path]
    output: str | PathLike[str]
    laws: Sequence[Any] = (None,)
    prestress: Sequence[bool] = (True,)
    team_size: int | None = None
    resume: bool = False
    overwrite: bool = False

    def check(self) -> None:
        """Refuse files that are missing, and an output that exists or cannot be written."""
        for file in self.files:
            if not file.exists():
                raise InputError(f"{file}: no such file")
        check_output(self.output, overwrite=self.overwrite or self.resume, inputs=self.files)


@dataclass(frozen=True)
class Job:
    """A packing, with or without pre-stress, and the laws that are computed together.

    Attributes
    ----------
    file : Path
    checksum : str
    particles : int
    groups : dict
        The name of the result for each law.
    prestress : bool
    """

    file: Path
    checksum: str
    particles: int
    groups: dict[Any, str]
    prestress: bool

    @property
    def name(self) -> str:
        """Name of the packing."""
        return readable(self.file.stem)

    def missing(self, there: Made) -> set[str]:
        """Return the names of results that are not ``there``. The model is always that of all laws."""
        return {name for law, name in self.groups.items() if (self.checksum, str(law), self.prestress) not in there}


class Analysis(ABC):
    """The computation for each packing of an ensemble."""

    named_alike = True  # whether names of results contain law and pre-stress even if there is only one
    out_of_core = False

    @property
    def made_with(self) -> str:
        """Text that is stored with each result and compared on resuming."""
        return ""

    @property
    @abstractmethod
    def settings(self) -> str:
        """All settings as text; the ranks must agree on it."""

    def together(self, law: DampingLaw | None) -> Any:
        """Return the key of laws that are computed together."""
        return law

    @abstractmethod
    def there(self, ensemble: Ensemble) -> Made:
        """Return the results in the output, or raise an error if they were made with other settings."""

    @abstractmethod
    def results(self, packing: Packing, laws: Sequence[Any], **common: Any) -> Iterator[tuple[Any, Result]]:
        """Yield each law and its result. Collective.

        Parameters
        ----------
        packing : Packing
        laws : sequence
            Those that are computed together.
        **common
            prestress, comm, name and progress, as for :func:`petscjam.spectrum`.
        """

    def line(self, name: str, result: Any, seconds: float, before: Any) -> str:
        """Return a line of the log.

        Parameters
        ----------
        name : str
            Of the result.
        result : object
        seconds : float
            Time of the computation.
        before : object
            The previous result of the same job, or None.
        """
        return f"{name}: {seconds:.1f} s"


@dataclass(frozen=True, eq=False)
class PackingAnalysis(Analysis):
    """``function(packing, **options, prestress=…, comm=…, name=…, progress=…)``, and ``damping=…`` if there are laws.

    Attributes
    ----------
    function : callable
        Returns one of the kinds of results of :mod:`petscjam.io.results`.
    options : dict
    """

    function: Callable[..., Any]
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def made_with(self) -> str:
        """For instance ``lowest_modes(count=50)``."""
        options = (f"{key}={np.asarray(value).tolist()}" for key, value in self.options.items())
        return f"{self.function.__name__}({', '.join(options)})"

    @property
    def settings(self) -> str:
        """The same."""
        return self.made_with

    def there(self, ensemble: Ensemble) -> Made:
        """Return the results in the output; all must have been made by this function with these options."""
        items = inventory(ensemble.output)
        for item in items:
            own = item.made_with or "another verb"
            if own.replace("rebuilt_response(", "mode_sum(") != self.made_with:  # an earlier name
                raise InputError(
                    f"{ensemble.output}: {item.name} was made by {own}, not {self.made_with}; cannot be resumed"
                )
        return {(item.checksum, item.damping, item.prestress) for item in items}

    def results(self, packing: Packing, laws: Sequence[Any], **common: Any) -> Iterator[tuple[Any, Result]]:
        """Yield the result for each law.

        Parameters
        ----------
        packing : Packing
        laws : sequence of DampingLaw or None
        **common
            Arguments of every analysis: ``comm``, ``name``, ….
        """
        for law in laws:
            damping = {} if law is None else {"damping": law}
            yield law, self.function(packing, **self.options, **damping, **common)


@dataclass(frozen=True, eq=False)
class ModulusAnalysis(Analysis):
    """G*(ω) at some frequencies, by default from a reduced model.

    Attributes
    ----------
    omegas : (W,)
        Angular frequencies, 1/τ1.
    strain : str
        Name of a strain mode.
    rtol : float
        Bound on |ΔG*|/|G*| that the reduced model must meet.
    direct : bool
        Solve at each frequency instead.
    mass : float or None
        Of every disk, in units of k τ1²; None: no inertia.
    fields_at : (F,)
        Frequencies, of ``omegas``, at which displacements are stored.
    family : bool
        One model in (ω, β) for all β of contact damping (:func:`petscjam.beta_family`). It needs fewer
        factorisations than a model for each β; its errors are estimates, not bounds.
    out_of_core, block_low_rank : bool, float
        As for :func:`petscjam.spectrum`.
    """

    omegas: ArrayLike
    strain: str = "simple-shear"
    rtol: float = 1e-6
    direct: bool = False
    mass: float | None = None
    fields_at: ArrayLike = ()
    family: bool = False
    out_of_core: bool = False
    block_low_rank: float = 0.0
    named_alike = False

    @property
    def settings(self) -> str:
        """All fields."""
        return f"G*({', '.join(f'{key}={np.asarray(value).tolist()}' for key, value in vars(self).items())})"

    def together(self, law: DampingLaw | None) -> Any:
        """Return the same key for laws that differ only in β, or only in ηF, if one model is valid for all."""
        if self.family and self._in_family(law):
            return ContactDamping, law.rotations  # type: ignore[union-attr]
        return StokesDrag if isinstance(law, StokesDrag) and not self.direct else law

    def way(self, laws: Sequence[DampingLaw]) -> str:
        """Return a line on the method for several β; empty for a single one."""
        count = sum(self._in_family(law) for law in laws)
        if count < 2:
            return ""
        if self.family:
            return f"{count} values of beta: one model in (omega, beta) for each packing; its errors are estimates"
        return f"{count} values of beta: one model for each"

    def _in_family(self, law: DampingLaw | None) -> bool:
        known = isinstance(law, ContactDamping) and 0 < law.beta <= LARGEST_BETA
        return known and not self.direct and np.ptp(np.asarray(self.omegas)) > 0

    def there(self, ensemble: Ensemble) -> Made:
        """Return the results in the output; all must have these laws, frequencies and accuracy."""
        pairs = [(law, kept) for law in ensemble.laws for kept in ensemble.prestress]
        wanted = [{"strain": self.strain, "damping": str(law), "prestress": kept} for law, kept in pairs]
        omegas, fields_at = np.asarray(self.omegas), np.asarray(self.fields_at, dtype=float)
        return done(ensemble.output, wanted, omegas, fields_at, None if self.direct else self.rtol, self.mass)

    def results(self, packing: Packing, laws: Sequence[Any], **common: Any) -> Iterator[tuple[Any, ComplexModulus]]:
        """Yield G* under each law.

        Parameters
        ----------
        packing : Packing
        laws : sequence of DampingLaw
        **common
            Arguments of every analysis: ``comm``, ``name``, ….
        """
        common["strain"], first = self.strain, laws[0]
        if self.direct:
            common["fields_at"] = self.fields_at
            yield first, complex_modulus(packing, self.omegas, damping=first, mass=self.mass, **common)
            return
        omegas = np.asarray(self.omegas)
        span = float(omegas.min()), float(omegas.max())
        common |= {"rtol": self.rtol, "displacements": np.size(self.fields_at) > 0}
        common |= {"out_of_core": self.out_of_core, "block_low_rank": self.block_low_rank}
        if len(laws) == 1:
            models = iter([spectrum(packing, span, damping=first, mass=self.mass, **common)])
        elif isinstance(first, ContactDamping):
            betas = [law.tangential for law in laws]
            member = beta_family(packing, (min(betas), max(betas)), span, rotations=first.rotations, **common)
            models = map(member, betas)
        elif strain_mode(self.strain).shears_fluid:
            # the fluid increases |G*|: the smallest viscosity needs the smallest absolute error
            least = spectrum(packing, span, damping=min(laws, key=lambda law: law.fluid), mass=self.mass, **common)
            models = (least.with_fluid(law.fluid) for law in laws)
        else:
            models = (spectrum(packing, span, damping=law, mass=self.mass, **common) for law in laws)
        for law, model in zip(laws, models, strict=True):
            yield law, ComplexModulus.sampled(model, self.omegas, self.fields_at)

    def line(self, name: str, g: ComplexModulus, seconds: float, before: ComplexModulus | None) -> str:
        """Return a line of the log: the cost of the result, and its error.

        Parameters
        ----------
        name : str
            Of the result.
        g : ComplexModulus
        seconds : float
        before : ComplexModulus or None
            The previous result, which may be from the same factorisations.
        """
        made, accuracy = g.performance, f"residual {g.residuals.max():.1e}"
        same = g.model and before and before.model and g.model.nodes is before.model.nodes
        if g.model:
            accuracy = f"{'error bound' if g.model.definite else 'estimate'} {g.errors.max():.1e}"
        flops = f"{made['flops']:.1e} flops, " if "flops" in made else ""
        return (
            f"{name}: {'the same' if same else made['factorisations']} factorisations, {accuracy}, "
            f"MUMPS {made['mumps_MB']:.0f} MB, {flops}{seconds:.1f} s"
        )


@deferred()
def analyse(
    ensemble: Ensemble,
    analysis: Analysis,
    *,
    comm: Comm,
    progress: Report | None = None,
    log: Callable[[str], None] = print,
) -> tuple[int, list[str]]:
    """Add the results of an analysis of every packing, under each law, to the output: one group each. Collective.

    The file is complete at every moment and contains all finished results.

    Parameters
    ----------
    ensemble : Ensemble
    analysis : Analysis
    comm : communicator
        Its ranks are divided into teams; each team works on one packing after the other.
    progress : callable, optional
        Called with the completed fraction of a team's work and a text.
    log : callable
        Called with a line for each result, on the first rank of its team.

    Returns
    -------
    made : int
        Number of results that were added.
    failures : list of str
        Reasons of those that failed.

    Raises
    ------
    InputError
        If a file is missing or not a packing, or the output exists or was made with other settings.
    InputError, SolverError
        If there is one job, or there are several and all are refused.
    """
    agree(comm, ensemble, analysis.settings)

    def plan() -> tuple[list[Job], Made]:
        ensemble.check()
        jobs = list(_jobs(ensemble, analysis))
        there = analysis.there(ensemble) if ensemble.resume and Path(ensemble.output).exists() else set()
        return [job for job in jobs if job.missing(there)], there

    with claimed(ensemble.output, comm):
        jobs, there = on_root(comm, plan)
        work = _Work(ensemble, analysis, there, comm.bcast(uuid4().hex), log)
        size = ensemble.team_size or _team_size(jobs, comm, analysis.out_of_core)
        lost = deal(comm, jobs, work, cost=lambda job: job.particles, size=min(size, comm.size), progress=progress)
    refused = sum(isinstance(error, InputError) for _, error in lost)
    if lost and not there and (len(jobs) == 1 or refused == len(jobs)):  # invalid arguments
        raise lost[0][1]
    return comm.allreduce(work.made), [str(error) for _, error in lost]


@dataclass
class _Work:
    """The work of a rank in :func:`analyse`; ``made`` counts the results that it stored."""

    ensemble: Ensemble
    analysis: Analysis
    there: Made
    run: str
    log: Callable[[str], None]
    made: int = 0

    def __call__(self, job: Job, team: Team, report: Report | None) -> None:
        first = team.comm.rank == 0
        if job.particles >= LARGE and first:
            memory = f"{factor_memory(3 * job.particles):.0f} MB on {team.comm.size} ranks"
            self.log(f"{job.name}: {job.particles} disks, a factor of about {memory}")
        start, before = time.perf_counter(), None
        for law, result in self._results(job, team, report):
            name = job.groups[law]
            if name not in job.missing(self.there):
                continue
            on_root(team.comm, self._store, result, name, team.count > 1)
            if first:
                self.made += 1
                self.log(self.analysis.line(name, result, time.perf_counter() - start, before))
            start, before = time.perf_counter(), result

    def _results(self, job: Job, team: Team, report: Report | None) -> Iterator[tuple[Any, Result]]:
        """Yield each law and its result; an error names the file of the packing."""
        packing: Packing = on_root(team.comm, import_packing, job.file)
        common = {"prestress": job.prestress, "comm": team.comm, "name": job.name, "progress": report}
        with naming(job.file):
            yield from self.analysis.results(packing, list(job.groups), **common)

    def _store(self, result: Any, name: str, shared: bool) -> None:
        """Add a result; the first result replaces the file, unless ``resume`` is set."""
        output, run = self.ensemble.output, self.run
        with turn(output) if shared else nullcontext():
            fresh = not self.ensemble.resume and run_of(output) != run
            append_result(result, output, name, run=run, fresh=fresh, made_with=self.analysis.made_with)


def _jobs(ensemble: Ensemble, analysis: Analysis) -> Iterator[Job]:
    """Name every result: by packing and checksum and, if there are several, by law and pre-stress."""
    laws = list(dict.fromkeys(ensemble.laws))
    together: dict[Any, list[DampingLaw | None]] = {}
    for law in laws:
        together.setdefault(analysis.together(law), []).append(law)
    by_law = len(ensemble.laws) > 1 or (analysis.named_alike and laws[0] is not None)
    by_prestress = len(ensemble.prestress) > 1 or analysis.named_alike
    seen = set()
    for file in ensemble.files:
        packing = import_packing(file)
        name = group_name(packing, readable(file.stem))
        if name in seen:
            continue
        seen.add(name)
        for kept in ensemble.prestress:
            tag = f" with{'' if kept else 'out'} pre-stress" * by_prestress
            for some in together.values():
                groups = {law: name + f" {law}" * by_law + tag for law in some}
                yield Job(file, packing.checksum, len(packing), groups, kept)


def _team_size(jobs: Sequence[Job], comm: Comm, out_of_core: bool) -> int:
    """Return the ranks for each job, so that all ranks work and factors fit into the memory of a node."""
    size = max(1, comm.size // max(1, len(jobs)))
    need = factor_memory(3 * max((job.particles for job in jobs), default=0))
    there = available_memory()
    while not out_of_core and size < comm.size and need * (comm.size / size) > there:
        size *= 2
    return min(comm.bcast(size), int(comm.size))

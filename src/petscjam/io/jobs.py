"""Results of many packings under one or several laws, dealt to teams of ranks, and averages of moduli.

Axes: w frequency.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError, SolverError, readable
from petscjam.base.files import check_output, naming
from petscjam.base.interrupt import Interrupted, check, deferred
from petscjam.base.progress import Report, part
from petscjam.base.types import Array
from petscjam.geometry.packing import Packing
from petscjam.io.importers import import_packing
from petscjam.io.results import append_result, done, group_name, inventory, run_of
from petscjam.parallel.claims import claimed, turn
from petscjam.parallel.comm import agree, on_root, raise_together
from petscjam.parallel.memory import available_memory, factor_memory
from petscjam.parallel.teams import Team, teams
from petscjam.response.family import LARGEST_BETA, beta_family
from petscjam.response.moduli import complex_modulus
from petscjam.response.reduced import spectrum
from petscjam.response.result import ComplexModulus
from petscjam.rows.damping import ContactDamping, DampingLaw, StokesDrag
from petscjam.rows.kinematics import strain_mode

FAMILY = 4  # values of β from which one model in (ω, β) is made: its errors are estimates
LARGE = 20_000  # disks from which the memory of a factor is announced


@dataclass(frozen=True)
class Job:
    """What one piece of work gives: of a packing (a file), with or without pre-stress, under some laws.

    Attributes
    ----------
    file : Path
    checksum : str
    particles : int
    groups : dict
        The name of the result for each law. Several laws differ in β alone, or in ηF alone; None stands for
        any law where none matters.
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

    def missing(self, there: set[tuple[str, str, bool]]) -> set[str]:
        """Return the names of results that are not ``there``. The model is that of all laws all the same."""
        return {name for law, name in self.groups.items() if (self.checksum, str(law), self.prestress) not in there}


def sweep(
    files: Sequence[Path],
    omegas: Array,
    output: str | PathLike[str],
    *,
    laws: Sequence[DampingLaw],
    prestress: Sequence[bool] = (True,),
    strain: str = "simple-shear",
    rtol: float = 1e-6,
    direct: bool = False,
    fields_at: ArrayLike = (),
    comm: Any,
    team_size: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    out_of_core: bool = False,
    block_low_rank: float = 0.0,
    progress: Report | None = None,
    log: Callable[[str], None] = print,
) -> tuple[int, list[str]]:
    """Add G* of each of ``files`` under each law to ``output``, one group a result.

    Returns how many were made, and why others failed.

    Jobs are dealt to teams of ``team_size`` ranks; left out, one rank a team, more where there are fewer jobs
    than ranks or the factors would not fit into memory. The file is whole at every moment and holds what is
    finished. ``log`` gets a line for each result, on the first rank of its team.

    Raises
    ------
    InputError
        On files that are missing or no packings, an output that exists or was made with other settings.
    """
    agree(
        comm,
        files,
        omegas,
        output,
        laws,
        prestress,
        strain,
        rtol,
        direct,
        fields_at,
        team_size,
        resume,
        overwrite,
        out_of_core,
        block_low_rank,
    )
    fields_at = np.asarray(fields_at, dtype=float)

    def plan() -> tuple[list[Job], set[tuple[str, str, bool]]]:
        _check_files(files, output, overwrite=overwrite or resume)
        jobs = list(_jobs(files, laws, prestress, together=not direct))
        there: set[tuple[str, str, bool]] = set()
        if resume and Path(output).exists():
            wanted = [{"strain": strain, "damping": str(law), "prestress": p} for law in laws for p in prestress]
            there = done(output, wanted, omegas, fields_at, None if direct else rtol)
        return jobs, there

    def solve(job: Job, team: Team, report: Report | None) -> Iterator[tuple[str, ComplexModulus]]:
        return _solve(
            job,
            team,
            omegas,
            strain,
            rtol,
            direct,
            fields_at,
            report,
            out_of_core=out_of_core,
            block_low_rank=block_low_rank,
        )

    with claimed(output, comm):
        jobs, there = on_root(comm, plan)
        return _run(
            jobs,
            there,
            output,
            solve,
            _Line(),
            comm=comm,
            team_size=team_size,
            resume=resume,
            out_of_core=out_of_core,
            progress=progress,
            log=log,
        )


def survey(
    files: Sequence[Path],
    output: str | PathLike[str],
    analyse: Callable[..., Any],
    settings: Mapping[str, Any],
    *,
    laws: Sequence[DampingLaw | None] = (None,),
    prestress: Sequence[bool] = (True,),
    comm: Any,
    team_size: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Report | None = None,
    log: Callable[[str], None] = print,
) -> tuple[int, list[str]]:
    """Add ``analyse(packing, **settings, prestress=…, comm=…, name=…, progress=…)`` of each file.

    With ``damping=…`` besides, for each of ``laws``, unless that is None. Dealt to teams, stored, resumed and
    told as in :func:`sweep`, whose other parameters and results are the same.

    Raises
    ------
    InputError
        On files that are missing or no packings, an output that exists or was made with other settings.
    """
    wanted = f"{analyse.__name__}({', '.join(f'{key}={_plainly(value)}' for key, value in settings.items())})"
    agree(comm, files, output, wanted, laws, prestress, team_size, resume, overwrite)

    def plan() -> tuple[list[Job], set[tuple[str, str, bool]]]:
        _check_files(files, output, overwrite=overwrite or resume)
        jobs = list(_jobs(files, laws, prestress, together=False, tagged=True))
        there: set[tuple[str, str, bool]] = set()
        if resume and Path(output).exists():
            for item in inventory(output):
                if item.made_with != wanted:
                    own = item.made_with or "another verb"
                    raise InputError(f"{output}: {item.name} was made by {own}, not {wanted}; cannot be resumed")
                there.add((item.checksum, item.damping, item.prestress))
        return jobs, there

    def solve(job: Job, team: Team, report: Report | None) -> Iterator[tuple[str, Any]]:
        packing: Packing = on_root(team.comm, import_packing, job.file)
        for law, name in job.groups.items():
            with naming(job.file):
                yield (
                    name,
                    analyse(
                        packing,
                        **settings,
                        **({} if law is None else {"damping": law}),
                        prestress=job.prestress,
                        comm=team.comm,
                        name=job.name,
                        progress=report,
                    ),
                )

    with claimed(output, comm):
        jobs, there = on_root(comm, plan)
        return _run(
            jobs,
            there,
            output,
            solve,
            lambda name, result, seconds: f"{name}: {seconds:.1f} s",
            comm=comm,
            team_size=team_size,
            resume=resume,
            made_with=wanted,
            progress=progress,
            log=log,
        )


def _plainly(value: Any) -> str:
    return str(np.asarray(value).tolist())


def _check_files(files: Sequence[Path], output: str | PathLike[str], *, overwrite: bool) -> None:
    for file in files:
        if not file.exists():
            raise InputError(f"{file}: no such file")
    check_output(output, overwrite=overwrite, inputs=files)


@deferred()
def _run(
    jobs: Sequence[Job],
    there: set[tuple[str, str, bool]],
    output: str | PathLike[str],
    solve: Callable[[Job, Team, Report | None], Iterator[tuple[str, Any]]],
    line: Callable[[str, Any, float], str],
    *,
    comm: Any,
    team_size: int | None,
    resume: bool,
    made_with: str = "",
    out_of_core: bool = False,
    progress: Report | None,
    log: Callable[[str], None],
) -> tuple[int, list[str]]:
    """Deal what is missing to teams, and store each result as it comes."""
    jobs = [job for job in jobs if job.missing(there)]
    run = comm.bcast(uuid4().hex)
    made, failures, bad = 0, [], 0
    stopped: Interrupted | None = None
    if jobs:
        size = team_size or _team_size(max(job.particles for job in jobs), len(jobs), comm, out_of_core)
        with teams(comm, min(size, comm.size)) as team:
            mine = team.deal(jobs, lambda job: job.particles)
            for k, job in enumerate(mine):
                report = part(progress, k, len(mine), f"{job.name}: ") if progress else None
                if job.particles >= LARGE and team.comm.rank == 0:
                    log(
                        f"{job.name}: {job.particles} disks, a factor of about "
                        f"{factor_memory(3 * job.particles):.0f} MB on {team.comm.size} ranks"
                    )
                start = time.perf_counter()
                try:
                    check(team.comm)
                    for name, result in solve(job, team, report):
                        if name not in job.missing(there):
                            continue
                        on_root(team.comm, _store, result, output, name, run, resume, team.count > 1, made_with)
                        made += team.comm.rank == 0
                        if team.comm.rank == 0:
                            log(line(name, result, time.perf_counter() - start))
                        start = time.perf_counter()
                except (InputError, SolverError) as error:  # the same on all ranks of the team
                    if len(jobs) == 1 and not there:
                        raise
                    failures += [str(error)] * (team.comm.rank == 0)
                    bad += isinstance(error, InputError) and team.comm.rank == 0
                except Interrupted as signal:
                    stopped = signal
                    break
    everyone = comm.allgather((made, failures))
    raise_together(comm, stopped)
    if jobs and not there and comm.allreduce(bad) == len(jobs):  # what was asked for makes no sense
        raise InputError(next(text for _, some in everyone for text in some))
    return sum(count for count, _ in everyone), [text for _, some in everyone for text in some]


def _jobs(
    files: Sequence[Path],
    laws: Sequence[DampingLaw | None],
    prestress: Sequence[bool],
    *,
    together: bool,
    tagged: bool = False,
) -> Iterator[Job]:
    """Name every result: by packing and checksum, if several or ``tagged`` by law and pre-stress, too.

    ``together`` gives the laws that one model can serve to one job.
    """
    sets: dict[Any, list[DampingLaw | None]] = {}
    for law in dict.fromkeys(laws):
        alike: Any = law
        if together and isinstance(law, ContactDamping) and 0 < law.beta <= LARGEST_BETA:
            alike = ContactDamping, law.rotations
        elif together and isinstance(law, StokesDrag):
            alike = StokesDrag
        sets.setdefault(alike, []).append(law)
    seen = set()
    for file in files:
        packing = import_packing(file)
        name = group_name(packing, readable(file.stem))
        if name in seen:
            continue
        seen.add(name)
        for kept in prestress:
            several = tagged or len(prestress) > 1
            tag = (" with pre-stress" if kept else " without pre-stress") if several else ""
            for alike in sets.values():
                named = (tagged and laws[0] is not None) or len(laws) > 1
                groups = {law: name + f" {law}" * named + tag for law in alike}
                yield Job(file, packing.checksum, len(packing), groups, kept)


def _team_size(particles: int, jobs: int, comm: Any, out_of_core: bool) -> int:
    """Return ranks for each job: no rank without work, and factors that fit into the memory of a node."""
    size = max(1, comm.size // jobs)
    need, there = factor_memory(3 * particles), available_memory()
    while not out_of_core and size < comm.size and need * (comm.size / size) > there:
        size *= 2
    return min(comm.bcast(size), int(comm.size))


def _solve(
    job: Job,
    team: Team,
    omegas: Array,
    strain: str,
    rtol: float,
    direct: bool,
    fields_at: Array,
    report: Report | None,
    **solver: Any,
) -> Iterator[tuple[str, ComplexModulus]]:
    """Yield the results of ``job`` by name."""
    packing: Packing = on_root(team.comm, import_packing, job.file)
    common: dict[str, Any] = {
        "strain": strain,
        "prestress": job.prestress,
        "comm": team.comm,
        "name": job.name,
        "progress": report,
    }
    first = next(iter(job.groups))
    with naming(job.file):
        if direct:
            result = complex_modulus(packing, omegas, damping=first, fields_at=fields_at, **common)
            yield job.groups[first], result
            return
        span = float(omegas.min()), float(omegas.max())
        common.update(rtol=rtol, displacements=len(fields_at) > 0, **solver)
        if isinstance(first, ContactDamping) and len(job.groups) >= FAMILY and span[0] < span[1]:
            betas = [law.tangential for law in job.groups]
            member = beta_family(packing, (min(betas), max(betas)), span, rotations=first.rotations, **common)
            for law, name in job.groups.items():
                yield name, ComplexModulus.sampled(member(law.tangential), omegas, fields_at)
        elif isinstance(first, StokesDrag) and strain_mode(strain).shears_fluid:
            # the fluid adds to |G*|: the least of it asks most of the model
            model = spectrum(packing, span, damping=min(job.groups, key=lambda law: law.fluid), **common)
            for law, name in job.groups.items():
                yield name, ComplexModulus.sampled(model.with_fluid(law.fluid), omegas, fields_at)
        else:
            for law, name in job.groups.items():
                model = spectrum(packing, span, damping=law, **common)
                yield name, ComplexModulus.sampled(model, omegas, fields_at)


def _store(
    result: Any, output: str | PathLike[str], group: str, run: str, keep: bool, shared: bool, made_with: str
) -> None:
    """Add a result; the first one of a run that does not keep what is there replaces the file."""
    with turn(output) if shared else nullcontext():
        fresh = not keep and run_of(output) != run
        append_result(result, output, group, run=run, fresh=fresh, made_with=made_with)


@dataclass
class _Line:
    """One line on each modulus; it remembers which model the latest one came from."""

    nodes: Any = None

    def __call__(self, group: str, g: ComplexModulus, seconds: float) -> str:
        made, same = g.performance, g.model is not None and g.model.nodes is self.nodes
        self.nodes = g.model and g.model.nodes
        certificate = f"residual {g.residuals.max():.1e}"
        if g.model is not None:
            certificate = f"{'certificate' if g.model.definite else 'estimate'} {g.errors.max():.1e}"
        flops = f"{made['flops']:.1e} flops, " if "flops" in made else ""
        return (
            f"{group}: {'the same' if same else made['factorisations']} factorisations, {certificate}, "
            f"MUMPS {made['mumps_MB']:.0f} MB, {flops}{seconds:.1f} s"
        )

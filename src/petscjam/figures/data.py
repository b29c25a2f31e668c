"""The data of a figure of a paper: packings and results, which are computed once and stored."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from petscjam.base.errors import InputError, SolverError
from petscjam.base.progress import Report
from petscjam.figures.page import Page
from petscjam.figures.parameters import Parameters
from petscjam.io.jobs import Analysis, Ensemble, analyse
from petscjam.io.results import read_results
from petscjam.parallel.comm import Comm, on_root
from petscjam.plots.legends import given
from petscjam.preparation.library import prepare_library, read_library
from petscjam.rows.damping import DampingLaw


@dataclass
class FigureData:
    """The packings and results of one figure, and its page.

    Attributes
    ----------
    parameters : Parameters
    folder : Path
        Folder of the results, with packings in ``packings``.
    comm : communicator
    overwrite : bool
        Compute results again; packings are kept.
    existing : bool
        Prepare no packings: use the existing ones.
    progress, log : callable
        As for :func:`petscjam.io.jobs.analyse`.
    page : Page
    checksums : dict
        Of the packings.
    engine : str
        Of sheared runs, a name of :data:`petscjam.md.runs.ENGINES`.
    """

    parameters: Parameters
    folder: Path
    comm: Comm
    overwrite: bool = False
    existing: bool = False
    progress: Report | None = None
    log: Callable[[str], None] = print
    page: Page = field(default_factory=Page)
    checksums: dict[Path, str] = field(default_factory=dict)
    engine: str = "cpu"

    @property
    def picture(self) -> Path:
        """The file of the picture."""
        return self.folder / f"{self.parameters.figure}.png"

    def packings(self, particles: int, pressures: Iterable[float]) -> list[Path]:
        """Return the packings of the seeds of the preset that are proved minima, prepared if necessary.

        Parameters
        ----------
        particles : int
        pressures : iterable of float
            Target pressures, k.

        Raises
        ------
        InputError
            If there is none.
        """
        wanted, seeds = [float(f"{p:.12g}") for p in pressures], self.parameters["seeds"]
        folder = self.folder / "packings"
        if self.existing:
            library = on_root(self.comm, read_library, folder)
        else:
            library = prepare_library(
                folder, [particles], wanted, seeds, comm=self.comm, resume=True, progress=self.progress
            )
        rows = [r for r in library.rows if r["particles"] == particles and r["target"] in wanted and r["seed"] in seeds]
        proved = {library.folder / r["file"]: r["checksum"] for r in rows if r["proved"]}
        if not proved:
            raise InputError(f"{self.parameters.figure}: no proved packing of {particles} disks in {folder}")
        self.checksums |= proved
        missing = len(wanted) * len(seeds) - len(proved)
        self.page.tallies.append(
            f"{len(proved)} packings: N = {particles}; "
            f"p = {', '.join(f'{p:.3g}' for p in wanted)}; {len(seeds)} seeds. "
            f"Left out because not there or not proved minima: {missing}."
        )
        return list(proved)

    def results(
        self,
        files: Sequence[Path],
        analysis: Analysis,
        laws: Sequence[DampingLaw | None] = (None,),
        prestress: Sequence[bool] = (True,),
        *,
        tag: str = "",
    ) -> dict[str, Any]:
        """Return the results of an analysis of packings by name, computed if necessary; on rank 0 only. Collective.

        Parameters
        ----------
        files : sequence of Path
            As :meth:`packings` returns them.
        analysis : Analysis
        laws, prestress : sequences
            As for :class:`petscjam.io.jobs.Ensemble`.
        tag : str
            The results are stored in ``NAME-TAG.h5``.

        Raises
        ------
        InputError
            If the file has results of other settings.
        SolverError
            If there is no result.
        """
        output = self.folder / f"{self.parameters.figure}{tag and '-'}{tag}.h5"
        ensemble = Ensemble(files, output, laws, prestress, resume=not self.overwrite, overwrite=self.overwrite)
        _, failures = analyse(ensemble, analysis, comm=self.comm, progress=self.progress, log=self.log)
        if failures and not on_root(self.comm, output.exists):
            raise SolverError("; ".join(failures))
        if failures:
            self.page.tallies.append(f"{len(failures)} results failed: {'; '.join(failures)}")
        wanted = {self.checksums[file] for file in files}
        results: dict[str, Any] = {}
        on_root(self.comm, lambda: results.update(read_results(output)))  # they may be large
        return {name: r for name, r in results.items() if r.origin.checksum in wanted}

    def stable(self, results: Mapping[str, Any], what: str) -> dict[str, Any]:
        """Return the stable results, and note the number of unstable ones at each pressure. Collective.

        Parameters
        ----------
        results : dict
            As :meth:`results` returns them.
        what : str
            Their name on the page.

        Raises
        ------
        SolverError
            If there are results, and none is stable.
        """
        kept = {name: r for name, r in results.items() if r.stable}
        packings: dict[str, set[str]] = {}
        lost: dict[str, set[str]] = {}
        for r in results.values():
            key = f"N = {r.origin.particles}, p = {r.origin.pressure:.3g}, {given(r.prestress)}"
            for kind in [packings] + [lost] * (not r.stable):
                kind.setdefault(key, set()).add(r.origin.checksum)
        gone = "; ".join(f"{key}: {len(lost[key])} of {len(packings[key])}" for key in sorted(lost))
        self.page.tallies.append(f"{what}: packings left out as unstable (G0 ≤ 0 or negative modes): {gone or 'none'}.")
        if self.comm.bcast(bool(results) and not kept):
            raise SolverError(f"{self.parameters.figure}: {what}: none of {len(results)} results is stable")
        return kept

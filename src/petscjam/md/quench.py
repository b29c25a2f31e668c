"""From a sheared run to the linear response: the energy of a snapshot is minimised at a fixed cell.

Size and shape of the cell do not relax, so the minimum has a shear stress: the packing is anisotropic, and its
cell is tilted by γLy modulo Lx.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from petscjam.base.errors import InputError
from petscjam.base.progress import Progress, reporting
from petscjam.base.versions import release
from petscjam.geometry.packing import Packing
from petscjam.md.result import Run
from petscjam.md.state import State
from petscjam.preparation.prepare import BUDGET, relax_packing

SETTINGS = ("model", "law", "Q", "potential", "drag", "spin_drag", "mass", "protocol", "start", "seed")


def snapshot(run: Run) -> Packing:
    """Return the disks at the end of ``run``, not minimised. Units: ds and ke/ds².

    The potential is that of the run.

    The provenance has the settings of the run that determine its last state, and phi, strain, rate (1/τe) and
    time (τe) of this state.
    """
    state = run.state
    made_by: dict[str, Any] = {"program": "petscjam", "version": release("petscjam")}
    settings = run.settings.attributes
    made_by.update({key: settings[key] for key in SETTINGS if key in settings})
    made_by.update(phi=state.phi, strain=state.strain, rate=state.rate, time=state.time)
    return replace(state.packing(), provenance=made_by)


@reporting
def quench(
    source: Run | State | Packing,
    *,
    method: str = "fire",
    threads: int = 1,
    budget: int = BUDGET,
    progress: Progress | None = None,
) -> Packing:
    """Return the nearest minimum of the energy at the box of ``source``, with its certificate.

    Velocities are set to zero, and the stress that the flow maintains is lost: the slower the flow, the closer
    the stress of the minimum to that of the flow.

    Parameters
    ----------
    source : Run, State or Packing
        A run stands for its last state.
    method, threads, budget, progress
        As for :func:`petscjam.relax_packing`.

    Returns
    -------
    Packing
        Its provenance is that of :func:`snapshot`, with ``quenched``, the checksum of the snapshot.

    Raises
    ------
    InputError
        If the disks lose their contacts: not jammed at their packing fraction.
    SolverError
        If the forces do not balance within the budget.
    """
    start = snapshot(source) if isinstance(source, Run) else source
    start = start.packing() if isinstance(start, State) else start
    start = replace(start, provenance={**start.provenance, "quenched": start.checksum})
    try:
        return relax_packing(start, method=method, threads=threads, budget=budget, progress=progress)
    except InputError as error:
        raise InputError(f"quench: at phi = {start.phi:.6f}: {error}") from None

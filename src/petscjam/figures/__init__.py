"""The figures of both papers and a few others: packings or runs, results, exponents, picture.

``FIGURES`` lists them. The parameters of each are in a file of its name, ``mpi_runs/bt3.toml``, or in that of its set
of runs, ``mpi_runs/vot_cd.toml``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petscjam.base.errors import InputError
from petscjam.base.files import check_output, naming, write_atomically
from petscjam.base.progress import Report
from petscjam.parallel.claims import claimed, made_folder
from petscjam.parallel.comm import Comm, agree, on_root

if TYPE_CHECKING:
    from petscjam.figures.page import Finding
    from petscjam.figures.parameters import Parameters

FIGURES = {
    "bt1": "G' and G'' over fourteen decades, and displacements of the disks",
    "bt2": "velocities that the viscous forces resist, in a packing",
    "bt3": "contact damping: G* at several pressures, and its collapse",
    "bt4": "undamped and weakly damped sliding (beta from 0), and damping without rotations",
    "bt5": "quasi-static sliding and non-affine motion against pressure",
    "bt6": "Stokes drag: the collapse, and the viscosity of the fluid",
    "bt7": "correlations of non-affine displacements",
    "bt8": "finite-size scaling of the viscosity",
    "modes": "low modes: floppiness, and number of modes of the quasi-static response",
    "drag": "nonlinear drag: equivalent damping of the whole packing and contact by contact",
    "nonlinear-drag": "nonlinear drag without equivalent damping, against both forms of it",
    "softening": "quasi-static shear: where linear response ends, against pressure",
    "vot1": "CD: pressure against Q at several packing fractions",
    "vot2": "CD: viscosity and Bagnold coefficient of the pressure against Q at several strain rates",
    "vot3": "CD: phase diagram, Newtonian and Bagnoldian flow in the plane of packing fraction and Q",
    "vot4": "CD: contacts against Q",
    "vot5": "CD: contacts, and duration times rate of collisions, against Q",
    "vot6": "CD: duration and rate of collisions against Q",
    "vot8": "CD: collision angles",
    "vot9": "CD: tangential collisions against Q",
    "vot10": "CD_rot: pressure against Q at several packing fractions",
    "vot11": "CD_rot: viscosity and Bagnold coefficient of the pressure against Q at several strain rates",
    "vot12": "CD_rot: contacts against Q",
    "vot13": "CD_rot: contacts, and duration times rate of collisions, against Q",
    "vot14": "CD_rot: duration and rate of collisions against Q",
    "vot15": "CD_rot: pressure against packing fraction at several Q",
    "vot16": "CD_rot: viscosity and Bagnold coefficient against packing fraction at several strain rates",
    "vot17": "CD_rot: phase diagram",
    "vot18": "CD_rot: collision angles",
    "vot19": "CD_rot: tangential collisions against Q",
    "vot20": "CD_rot: rotation of the disks against packing fraction",
    "vot21": "CD_rot: correlations of the velocities of contacts",
    "vot22": "CD_rot, large: pressure against packing fraction at several strain rates, and its kinks",
    "vot23": "CD_rot, large: macroscopic friction against packing fraction",
    "vot24": "CD_rot, large: shear banding against packing fraction",
    "vot25": "CD_rot, large: coexistence in the plane of packing fraction and strain rate",
    "vot26": "CD_rot, large: coexistence in the plane of pressure and strain rate",
    "vot27": "CD_rot, large: maps of packing fraction and strain rate",
    "vot28": "CD_rot, large: profiles of shear bands at constant pressure",
    "vot29": "CD_rot, large: coexistence in the plane of pressure and shear stress",
    "vot30": "CD_rot, large: shear stress against strain rate",
    "vot31": "CD_rot, large: ramps of the strain rate up and down",
    "vot32": "CD_rot: Qc and Q* from contacts at two strain rates",
    "vot33": "CD_rot: packing fraction of the transition from pressures at two strain rates",
    "vot34": "CD_rot, large: macroscopic friction at constant pressure, and the lever rule",
    "vot35": "CD_rot, large: states of coexisting bands, and the boundaries of coexistence",
    "vot36": "CD_rot, large: shear banding for two numbers of disks",
}
SETS = {  # figures that share runs and parameters: the module
    **dict.fromkeys((f"vot{k}" for k in (1, 2, 3, 4, 5, 6, 8, 9)), "vot_cd"),
    **dict.fromkeys((f"vot{k}" for k in (*range(10, 22), 32, 33)), "vot_cd_rot"),
    **dict.fromkeys((f"vot{k}" for k in (*range(22, 32), 34, 35, 36)), "vot_large"),
}


def module_of(name: str) -> str:
    """Return the module of a figure, and the name of its file of parameters."""
    return SETS.get(name, name.replace("-", "_"))


def presets(name: str, file: Path | None = None) -> dict[str, dict[str, Any]]:
    """Return the parameters of a figure by preset.

    Parameters
    ----------
    name : str
        One of :data:`FIGURES`.
    file : Path, optional
        TOML. Default: the one in the folder of the figure's module.

    Raises
    ------
    InputError
        If there is no such figure, or the file is not TOML.
    """
    if name not in FIGURES:
        raise InputError(f"figure {name!r} is unknown; known are {', '.join(FIGURES)}")
    module: Any = find_spec(f"petscjam.figures.{module_of(name)}")
    source = file or Path(module.origin).with_suffix(".toml")
    with naming(source):
        try:
            return tomllib.loads(source.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InputError(f"not TOML ({error})") from None


@dataclass(frozen=True)
class Request:
    """A figure, its preset, and the options of the command.

    Attributes
    ----------
    name, preset : str
    folder : Path
        Packings are in ``folder``/packings, for all figures.
    file : Path, optional
        File of parameters; default: that of the package.
    overwrite : bool
        Compute results again; packings are kept.
    resume : bool
        Keep existing results, and draw them.
    existing : bool
        Prepare no further packings, and make no further runs.
    engine : str
        Of sheared runs, a name of :data:`petscjam.md.runs.ENGINES`.
    """

    name: str
    preset: str
    folder: Path
    file: Path | None = None
    overwrite: bool = False
    resume: bool = False
    existing: bool = False
    engine: str = "cpu"

    @property
    def command(self) -> str:
        """The command, for the page."""
        command = f"petscjam figure {self.name} --preset {self.preset}"
        command += f" --parameters {self.file}" * (self.file is not None)
        command += f" --engine {self.engine}" * (self.engine != "cpu")
        return command + " --existing" * self.existing

    def parameters(self) -> Parameters:
        """Return the parameters of the preset, with the same names and kinds as those of the package.

        Raises
        ------
        InputError
            On an unknown figure, preset or parameter.
        """
        from petscjam.figures.parameters import Parameters

        known = presets(self.name, self.file)
        if self.preset not in known:
            raise InputError(f"--preset: {self.preset!r} is unknown for {self.name}; known are {', '.join(known)}")
        if not isinstance(known[self.preset], dict):
            raise InputError(f"{self.file}: {self.preset} is not a table of parameters")
        parameters = Parameters(self.name, self.preset, known[self.preset])
        with naming(self.file) if self.file else nullcontext():
            parameters.check(presets(self.name)["small"])
        return parameters


def make_figure(
    request: Request, *, comm: Comm, progress: Report | None = None, log: Callable[[str], None] = print
) -> list[Finding]:
    """Make a figure: NAME.png, the page NAME.md, its numbers NAME.csv, and NAME*.h5 with the results. Collective.

    Parameters
    ----------
    request : Request
    comm : communicator
    progress, log : callable
        As for :func:`petscjam.io.jobs.analyse`.

    Raises
    ------
    InputError
        On an unknown figure, preset or parameter, or an output that exists.
    """
    from petscjam.figures.data import FigureData
    from petscjam.plots.figure import house_style

    agree(comm, request)
    parameters = on_root(comm, request.parameters)
    name, folder = request.name, request.folder
    picture, page, table = (folder / f"{name}.{kind}" for kind in ("png", "md", "csv"))
    with made_folder(folder, comm), claimed(picture, comm):
        for target in (picture, page, table):
            inputs = [request.file] if request.file else []
            on_root(comm, check_output, target, overwrite=request.overwrite or request.resume, inputs=inputs)
        data = FigureData(
            parameters, folder, comm, request.overwrite, request.existing, progress, log, engine=request.engine
        )
        with house_style():
            import_module(f"petscjam.figures.{module_of(name)}").draw(data)
        text = data.page.text(request.command, parameters.values)
        on_root(comm, write_atomically, page, text.encode())
        on_root(comm, write_atomically, table, data.page.table.encode())
        return list(comm.bcast(data.page.findings))

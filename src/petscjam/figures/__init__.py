"""The figures of Baumgarten & Tighe 2017 and a few beside them: packings, results, exponents, picture.

``FIGURES`` says what there is. The parameters of each stand in a file of its name, ``mpi_runs/bt3.toml``.
"""

from __future__ import annotations

import tomllib
from contextlib import nullcontext
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petscjam.base.errors import InputError
from petscjam.base.files import check_output, naming
from petscjam.base.progress import Report
from petscjam.parallel.claims import claimed, made_folder
from petscjam.parallel.comm import agree, on_root

if TYPE_CHECKING:
    from petscjam.figures.study import Finding

FIGURES = {
    "bt1": "G' and G'' over fourteen decades, and how the disks move",
    "bt2": "what the viscous forces resist, in a real packing",
    "bt3": "contact damping: G* at several pressures, and its collapse",
    "bt4": "undamped and weakly damped sliding (beta from 0), and disks that do not roll",
    "bt5": "quasi-static sliding and non-affine motion against pressure",
    "bt6": "Stokes drag: the collapse, and the viscosity of the fluid",
    "bt7": "correlations of non-affine displacements",
    "bt8": "finite-size scaling of the viscosity",
    "modes": "low modes: floppiness, and how many make up the quasi-static response",
    "drag": "nonlinear drag: equivalent damping of the whole packing and contact by contact",
}


def presets(name: str, file: Path | None = None) -> dict[str, dict[str, Any]]:
    """Return the parameters of figure ``name`` by preset, from its own file or another ``file``.

    Raises
    ------
    InputError
        If there is no such figure, or the file is not TOML.
    """
    if name not in FIGURES:
        raise InputError(f"figure {name!r} is unknown; known are {', '.join(FIGURES)}")
    source = file or files("petscjam.figures") / f"{name}.toml"
    with naming(str(source)):
        try:
            return tomllib.loads(source.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InputError(f"not TOML ({error})") from None


def make_figure(
    name: str,
    preset: str,
    folder: Path,
    *,
    file: Path | None = None,
    comm: Any,
    overwrite: bool = False,
    resume: bool = False,
    existing: bool = False,
    progress: Report | None = None,
    log: Any = print,
) -> list[Finding]:
    """Draw figure ``name`` into ``folder``: NAME.png, NAME.md with what was found, NAME*.h5 with the results.

    Packings lie in ``folder``/packings, for all figures. What is there already is kept, unless ``overwrite``;
    ``existing`` prepares no further packings.

    Raises
    ------
    InputError
        On an unknown figure or preset, a parameter that it does not know, an output that exists.
    """
    from petscjam.figures.study import Study

    agree(comm, name, preset, folder, file, overwrite, resume, existing)
    known = on_root(comm, presets, name, file)
    if preset not in known:
        raise InputError(f"--preset: {preset!r} is unknown for {name}; known are {', '.join(known)}")
    if not isinstance(known[preset], dict):
        raise InputError(f"{file}: {preset} is no table of parameters")
    shipped = on_root(comm, presets, name)["small"]
    expected, given = set(shipped), set(known[preset])
    for what, keys in (("lacks", expected - given), ("has the unknown", given - expected)):
        if keys:
            raise InputError(f"{name}: the preset {preset} {what} {', '.join(sorted(keys))}")
    picture = folder / f"{name}.png"
    with made_folder(folder, comm), claimed(picture, comm):
        for target in (picture, folder / f"{name}.md"):
            inputs = [file] if file else []
            on_root(comm, check_output, target, overwrite=overwrite or resume, inputs=inputs)
        study = Study(name, preset, known[preset], folder, comm, overwrite, existing, progress, log)
        with naming(file) if file else nullcontext():
            study.check(shipped)
        import_module(f"petscjam.figures.{name}").draw(study, picture)
        command = f"petscjam figure {name} --preset {preset}"
        command += f" --parameters {file}" * (file is not None) + " --existing" * existing
        on_root(comm, study.write, command)
        return list(comm.bcast(study.findings))

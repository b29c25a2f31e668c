"""Sheared disks as input of LAMMPS, for systems too large for one computer, and reading of its results.

LAMMPS's pair style ``granular`` has the forces of VOT except for two details. For disks with an overlap δ the
contact point is at R in its velocities and at R − δ/2 in its torques, not at r R/(Ri + Rj) as in VOT eq. 6; and
the damping uses velocities half a step earlier. So compare averages: their differences are of the order of the
overlap and dt.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations_with_replacement
from math import ceil
from numbers import Integral
from os import PathLike
from pathlib import Path

import numpy as np

from petscjam.base import ranges
from petscjam.base.arguments import parsed, parsed_whole
from petscjam.base.errors import InputError, shown
from petscjam.base.files import check_output, naming, write_atomically
from petscjam.base.types import Array
from petscjam.md.model import Model, stable_step
from petscjam.md.simulation import Simulation
from petscjam.md.state import State
from petscjam.parallel.claims import made_folder

SIZES = 10  # largest number of radii: each is an atom type, and each pair of types has its spring constant
FRAMES = 100  # default number of rows of a run
DISKS = """\
units lj
dimension 2
boundary p p p
atom_style sphere
newton on
box tilt large
read_data disks.data
set type * mass {mass}
comm_modify vel yes
pair_style granular
{pairs}
neighbor ${{skin}} bin
neigh_modify delay 0 every 1 check yes
"""
COLUMNS = "id type x y vx vy omegaz radius"
IN_SHEAR = """\
# {name}, Q = {Q:g}, in ds, m and tau_e. strain and time are those of disks.data.
# Only steps, every and skin may be set otherwise: lmp -var skin 0.2 -in in.shear
variable potential index {potential}
{settings}
log shear.log
{disks}
timestep ${{dt}}
fix shear all deform 1 xy erate ${{rate}} remap v flip yes
fix move all {integrator}

# LAMMPS's virial has the separation first. With the force first, as in VOT, xy differs by the torques.
variable gamma equal v_strain+v_rate*v_dt*step
compute pair all pressure NULL pair
compute torques all property/atom tqz
compute couple all reduce sum c_torques
variable pair_xy equal c_pair[4]+c_couple/vol
compute peculiar all temp/deform
compute kinetic all pressure peculiar ke
compute touching all contact/atom
compute contacts all reduce ave c_touching
thermo ${{every}}
thermo_style custom step v_gamma c_contacts &
    c_pair[1] v_pair_xy c_pair[4] c_pair[2] c_kinetic[1] c_kinetic[4] c_kinetic[2]
thermo_modify colname v_gamma strain colname c_contacts contacts &
    colname c_pair[1] pair_xx colname v_pair_xy pair_xy colname c_pair[4] pair_yx colname c_pair[2] pair_yy &
    colname c_kinetic[1] kinetic_xx colname c_kinetic[4] kinetic_xy colname c_kinetic[2] kinetic_yy
thermo_modify format float %.17g

dump frames all custom ${{every}} shear.dump {columns}
dump_modify frames sort id format float %.17g
run ${{steps}}
write_dump all custom end.dump {columns} modify sort id format float %.17g
"""
IN_ELASTIC = """\
# The elastic pressure of every frame of shear.dump; the rest of that of in.shear is dissipative.
variable skin index 0.1
log elastic.log
{disks}
compute elastic all pressure NULL pair
thermo 1
thermo_style custom step c_elastic[1] c_elastic[4] c_elastic[2]
thermo_modify colname c_elastic[1] elastic_xx colname c_elastic[4] elastic_xy colname c_elastic[2] elastic_yy
thermo_modify format float %.17g
rerun shear.dump dump x y
"""


def write_lammps(
    state: State,
    model: Model,
    folder: str | PathLike[str],
    *,
    rate: float,
    strain: float,
    dt: float | None = None,
    every: int | None = None,
    overwrite: bool = False,
) -> None:
    """Write input of LAMMPS that shears ``state``: disks.data, in.shear and in.elastic.

    ``lmp -in in.shear`` shears; it writes shear.log, the frames of shear.dump and, at the end, end.dump. A
    row of shear.log has the strain, the contacts of a disk, and the pressures of forces (``pair``) and of
    peculiar velocities; in xy, the first index is that of the force, as in VOT eq. 13. In its first row the
    boundaries do not move yet: leave it out. ``lmp -in in.elastic`` then computes the elastic part of the
    pressure for each row, in elastic.log; the rest of ``pair`` is dissipative.

    Parameters
    ----------
    state : State
        If ``rate`` is not its rate, the linear profile changes, but not the peculiar velocities.
    model : Model
    folder : path
        Made if necessary.
    rate : float
        Strain rate γ̇ in 1/τe, of either sign.
    strain : float
        Strain of the LAMMPS run, > 0, rounded up to whole time steps.
    dt : float
        Time step in τe; left out, as in :meth:`petscjam.md.model.Model.step`, or less if the contacts of
        ``state`` require it. LAMMPS does not divide it if later contacts require it.
    every : int
        Time steps between rows and between frames; default: a hundredth of the run.
    overwrite : bool
        Replace these three files, and remove end.dump.

    Raises
    ------
    InputError
        If LAMMPS cannot express the model, a number is wrong, dt is too large or a file cannot be written.
    """
    _check_model(state, model)
    ranges.RATE.check("lammps: rate", rate)
    ranges.RATE_SIZE.check("lammps: the size of the rate", abs(rate))
    ranges.STRAIN.check("lammps: strain", strain)
    dt = _time_step(state, model, dt)
    steps = ceil(strain / (abs(rate) * dt) * (1 - 1e-12))
    if steps > ranges.MOST_STEPS:
        raise InputError(f"lammps: {steps:.3g} time steps; at most {ranges.MOST_STEPS:.0g}")
    if every is None:
        every = max(1, steps // FRAMES)
    if not (isinstance(every, Integral) and every > 0):
        raise InputError(f"lammps: every must be a whole number above 0, not {shown(every)}")
    velocities = state.velocities + np.outer((rate - state.rate) * state.positions[:, 1], [1, 0])
    start = replace(state, velocities=velocities, rate=rate).wrapped()
    settings = {
        "rate": start.rate,
        "dt": dt,
        "strain": start.strain,
        "time": start.time,
        "steps": steps,
        "every": int(every),
        "skin": 0.1,
    }
    texts = _texts(start, model, settings)
    with made_folder(folder):
        for name in texts:
            check_output(Path(folder, name), overwrite=overwrite)
    for name, text in texts.items():
        write_atomically(Path(folder, name), text.encode())
    Path(folder, "end.dump").unlink(missing_ok=True)  # the final state of another run


def _texts(state: State, model: Model, settings: Mapping[str, float]) -> dict[str, str]:
    """Return the text of each file."""
    potential = model.potential
    script = IN_SHEAR.format(
        name=model.name,
        Q=model.Q,
        potential=potential.name,
        settings="\n".join(f"variable {name} index {value}" for name, value in settings.items()),
        disks=_disks(state.radii, model, model.normal, model.tangential / model.normal),
        integrator="nve/sphere disc" if model.rolls else "nve",
        columns=COLUMNS,
    )
    elastic = IN_ELASTIC.format(disks=_disks(state.radii, model, 0.0, 0.0))
    return {"disks.data": _data(state, model.rolls), "in.shear": script, "in.elastic": elastic}


def _check_model(state: State, model: Model) -> None:
    """Refuse what LAMMPS cannot express."""
    for value, good, what in (
        (model.potential.name, model.potential.exponent == 2, "harmonic potentials only, not"),
        (model.body, model.body == 0, "no drag of disks on the affine flow, but there is"),
        (model.fluid, model.fluid == 0, "no viscosity of a fluid, but there is"),
        (model.drag_exponent, model.drag_exponent == 1, "linear drag of contacts, but its exponent is"),
        (model.rotational_drag, model.rotational_drag == 0, "no drag on rotations, but there is"),
        (model.normal, model.normal > 0, "tangential damping only together with normal damping, which is"),
        (len(np.unique(state.radii)), len(np.unique(state.radii)) <= SIZES, f"up to {SIZES} radii, not"),
    ):
        if not good:
            raise InputError(f"lammps: its input has {what} {shown(value)}")


def _time_step(state: State, model: Model, dt: float | None) -> float:
    """Return ``dt``, or the default; damping from velocities half a step old is stable if dt λ/2 + dt² κ/4 ≤ 1."""
    relaxation, oscillation = Simulation(state, model).fastest()
    largest = stable_step("single", relaxation / 2, oscillation)
    dt = min(model.step(None, "heun"), largest) if dt is None else model.step(dt, "heun")
    if dt > largest:
        raise InputError(f"lammps: dt must be at most {largest:.3g} tau_e for these contacts, not {shown(dt)}")
    return dt


def read_lammps(path: str | PathLike[str], frame: int = -1) -> State:
    """Read a state of a run of :func:`write_lammps`.

    Parameters
    ----------
    path : path
        The folder, for its end.dump; or a dump in it, as shear.dump.
    frame : int
        Index of the frame of the dump, as in Python.

    Raises
    ------
    InputError
        If a file is missing, or the dump is damaged or not of such a run.
    """
    path = Path(path)
    path = path / "end.dump" if path.is_dir() else path
    source = path.with_name("in.shear")
    with naming(source):
        found = dict(re.findall(r"^variable (\w+) index (\S+)$", source.read_text(), re.MULTILINE))
        potential = found.get("potential", "harmonic-relative")  # older input has no other
        try:
            rate, dt, strain, time = (parsed(found[name]) for name in ("rate", "dt", "strain", "time"))
        except (KeyError, ValueError) as error:
            raise InputError(f"not as petscjam wrote it: no number for {error}") from None
    with naming(path):
        try:
            lines = path.read_text().split("ITEM: TIMESTEP\n")[1:][frame].splitlines()
            step, count, columns, disks = (
                parsed_whole(lines[0]),
                parsed_whole(lines[2]),
                lines[7],
                np.loadtxt(lines[8:], ndmin=2),
            )
            (xlo, xhi, xy), (ylo, yhi, _) = (map(parsed, line.split()) for line in lines[4:6])
        except (ValueError, IndexError) as error:
            raise InputError(f"no frame {frame}, or a damaged one ({error})") from None
        length, height = xhi - xlo - abs(xy), yhi - ylo  # the bounds are those of all corners
        for good, what in (
            (columns == f"ITEM: ATOMS {COLUMNS}", f"the columns are {columns!r}, not {COLUMNS}"),
            (disks.shape == (count, 8), f"frame {frame} has {disks.shape} numbers, not {(count, 8)}"),
            (length > 0 and height > 0, f"the cell is {length:g} x {height:g}"),
        ):
            if not good:
                raise InputError(what)
        length = height if np.isclose(length, height, rtol=1e-9) else length  # rounding
        elapsed, tilt, width = step * dt, xy / height, length / height
        strain = tilt + width * round((strain + rate * elapsed - tilt) / width)  # LAMMPS keeps |xy| below Lx/2
        moving = (disks[:, 2:4], disks[:, 4:6], disks[:, 6], disks[:, 7])
        return State(*moving, length, strain, rate, time + elapsed, potential, height)


def read_log(path: str | PathLike[str]) -> dict[str, Array]:
    """Read the table of the last run in a log of LAMMPS: a (K,) array for each column, by its heading.

    Raises
    ------
    InputError
        If the file cannot be read or has no table.
    """
    with naming(path):
        lines = [line.split() for line in Path(path).read_text().splitlines()]
        heads = [n for n, words in enumerate(lines) if words[:1] == ["Step"]]
        if not heads:
            raise InputError("no line begins with Step: not a log of LAMMPS, or its run has not begun")
        names, rows = lines[heads[-1]], []
        for words in lines[heads[-1] + 1 :]:
            if words[:2] == ["Loop", "time"]:
                break
            try:
                row = [float(word) for word in words]  # not from petscjam: nan
            except ValueError:  # a warning
                continue
            if len(row) == len(names):
                rows.append(row)
        return dict(zip(names, np.reshape(rows, (len(rows), len(names))).T, strict=True))


def _disks(radii: Array, model: Model, normal: float, ratio: float) -> str:
    """Return the commands up to the forces: damping ``normal``, and ``ratio`` times this for tangential damping."""
    pairs = [
        f"pair_coeff {a} {b} hooke {model.potential.k(ra + rb)} {normal} damping velocity "
        f"tangential linear_nohistory {ratio} 1.0e30"
        for (a, ra), (b, rb) in combinations_with_replacement(enumerate(np.unique(radii), 1), 2)
    ]
    return DISKS.format(pairs="\n".join(pairs), mass=model.mass)


def _data(state: State, rolls: bool) -> str:
    """Return LAMMPS's data file of disks inside the cell; with spins only if the model has rotations."""
    sizes, types = np.unique(state.radii, return_inverse=True)
    tilt = float(state.box.cell[1, 0])
    atoms = np.column_stack([types + 1, 2 * state.radii, state.positions])
    moving = np.column_stack([state.velocities, state.spins * rolls])
    return "\n".join(
        [
            f"disks at a strain of {state.strain}\n",
            f"{len(state)} atoms\n{len(sizes)} atom types\n",
            f"0.0 {state.length} xlo xhi\n0.0 {state.height} ylo yhi\n-0.5 0.5 zlo zhi\n{tilt} 0.0 0.0 xy xz yz\n",
            "Atoms # sphere\n",
            *(f"{i} {t:.0f} {d} 1.0 {x} {y} 0.0" for i, (t, d, x, y) in enumerate(atoms.tolist(), 1)),
            "\nVelocities\n",
            *(f"{i} {vx} {vy} 0.0 0.0 0.0 {spin}" for i, (vx, vy, spin) in enumerate(moving.tolist(), 1)),
            "",
        ]
    )

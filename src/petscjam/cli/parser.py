"""The options of every verb."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from importlib import import_module
from typing import Any, NoReturn, TypeAlias

from petscjam.base import ranges
from petscjam.base.arguments import (
    Within,
    diameters,
    engine,
    evenly,
    frequencies,
    integer,
    number,
    numbers,
    pairs,
    path,
    points,
    seeds,
    triple,
    whole,
)
from petscjam.base.errors import InputError
from petscjam.base.versions import release
from petscjam.cli import analyses, exports, shearing, verbs
from petscjam.cli.completion import Completion
from petscjam.cli.config import settings
from petscjam.cli.examples import EXAMPLES
from petscjam.cli.laws import option
from petscjam.cli.renamed import current
from petscjam.figures import FIGURES
from petscjam.geometry.potential import POTENTIALS
from petscjam.io.kinds import KINDS, class_of
from petscjam.md.model import BULK, INTEGRATORS, MODELS
from petscjam.parallel.comm import Comm
from petscjam.preparation.minimise import METHODS
from petscjam.preparation.prepare import BUDGET
from petscjam.response.origin import Verb
from petscjam.rows.damping import LAWS
from petscjam.rows.kinematics import STRAINS

Work = Callable[[argparse.Namespace, Comm], None]
Verbs: TypeAlias = "argparse._SubParsersAction[Parser]"

RANKS = "Runs in parallel: mpirun -n R petscjam {verb} …"
STATUS = "Exit status: 0 done, 2 bad input, 130 and 143 stopped by a signal, 1 anything else."


class Help(argparse.HelpFormatter):
    """Help with the range of each number."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Keep lines that begin with two spaces: commands."""
        return "\n".join(
            line if line.startswith("  ") else super(Help, self)._fill_text(line, width, indent)
            for line in text.splitlines()
        )

    def _get_help_string(self, action: argparse.Action) -> str | None:
        known = f"; {action.type.range}" if isinstance(action.type, Within) else ""
        return f"{action.help}{known}" if action.help else None


class Parser(argparse.ArgumentParser):
    """An argument parser that also reads a file of settings; each error is one line."""

    declare: Callable[[Parser], None] | None = None  # adds options when the verb is used
    ended = True  # whether it has the options of every verb

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**{"allow_abbrev": False, "formatter_class": Help, **kwargs})

    def complete(self) -> None:
        """Add the options of ``declare``, and those of every verb."""
        if self.declare:
            declare, self.declare = self.declare, None
            declare(self)
        if not self.ended:
            self.ended = True
            messages(self)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Replace old names, and put the options of ``--config FILE`` first: of two equal options the last counts.

        Parameters
        ----------
        args : list of str
        namespace : argparse.Namespace, optional
        """
        self.complete()
        args = list(sys.argv[1:] if args is None else args)
        if self._subparsers:
            if args[:1] == ["help"]:
                args = [*args[1:2], "--help"]
            known = list(self._subparsers._group_actions[0].choices or ())
            args = [*(current(verb, known) for verb in args[:1]), *args[1:]]
        else:
            args = [current(word, self._option_string_actions) for word in args]
        if "--config" in self._option_string_actions:
            args = [*settings(args, self._option_string_actions, self._mutually_exclusive_groups), *args]
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage."""
        raise InputError(f"{self.prog.removeprefix('petscjam').strip() or 'command line'}: {message}")


def build_parser() -> Parser:
    """Return the parser of all verbs."""
    parser = Parser(
        prog="petscjam",
        description="Linear response of jammed packings of soft disks, at every frequency.",
        epilog="petscjam help VERB describes a verb. PETSc options go after --, e.g. … -- -log_view. Units: stiffness "
        "k = 1, mean diameter d = 1, time tau1 = 1, unless a packing brings its own length unit.\n" + STATUS,
    )
    parser.add_argument("--version", action="version", version=f"petscjam {release('petscjam')}")
    text = 'print the completion of verbs, options and files for a shell: eval "$(petscjam --completion bash)"'
    parser.add_argument("--completion", action=Completion, choices=("bash", "zsh"), help=text)
    known = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=Parser)
    for verb in (_prepare, _info, _import, _export, _moduli):
        verb(known)
    for name, kind in KINDS.items():
        if kind.text:
            add(known, kind.verb or name, analyses.analyse, kind.text, RANKS).declare = partial(declare, kind=name)
    for verb in (_shear, _ramp, _figure, _plot, _report):
        verb(known)
    return parser


def _prepare(known: Verbs) -> None:
    p = add(known, "prepare", verbs.prepare, "make packings of bidisperse disks at target pressures", RANKS)
    text = "numbers of disks (default 1024)"
    p.add_argument("--particles", type=Within(whole, ranges.PREPARED), default="1024", metavar="N,…", help=text)
    text = "target pressures, in units of k: a list A,B,…, or A:B:N, evenly in log p, both ends counted (default 1e-3)"
    p.add_argument("--pressure", type=points, default="1e-3", metavar="P", help=text)
    either = p.add_mutually_exclusive_group()
    either.add_argument("--seed", type=Within(integer, ranges.SEED), help="seed of the random start (default 1)")
    text = "many seeds: A to B, both counted, or a list A,B,…"
    either.add_argument("--seeds", type=Within(seeds, ranges.SEED), metavar="A:B", help=text)
    text = "also relax the shape of the cell: stable against shear"
    p.add_argument("--shear-stabilised", action="store_true", help=text)
    text = "start each pressure from the packing of the next higher one"
    p.add_argument("--decompress", action="store_true", help=text)
    text = "diameter of large disks over that of small ones (default 1.4)"
    p.add_argument("--ratio", type=Within(number, ranges.RATIO), default=1.4, metavar="X", help=text)
    text = "share of small disks, by number (default 0.5)"
    p.add_argument("--composition", type=Within(number, ranges.COMPOSITION), default=0.5, metavar="X", help=text)
    text = "standard deviation over mean of the diameters of each kind (default 0)"
    p.add_argument("--polydispersity", type=Within(number, ranges.POLYDISPERSITY), default=0.0, metavar="X", help=text)
    p.add_argument("--potential", choices=POTENTIALS, default="harmonic", help="contact potential (default harmonic)")
    text = "minimiser: FIRE or nonlinear conjugate gradients (default fire)"
    p.add_argument("--method", choices=METHODS, default="fire", help=text)
    text = "threads of each rank (default: its share of the cores if the packings are large and few, else 1)"
    p.add_argument("--threads", type=Within(integer, ranges.THREADS), metavar="T", help=text)
    text = f"evaluations of the force for each packing (default {BUDGET})"
    p.add_argument("--budget", type=Within(integer, ranges.BUDGET), default=BUDGET, metavar="E", help=text)
    output(p, "FILE_OR_FOLDER", "packing (HDF5, H5MD layout), or the folder for several")


def _info(known: Verbs) -> None:
    p = add(
        known,
        "info",
        verbs.info,
        "print the content of a packing, a result, a sheared run, or a folder of packings or of runs",
    )
    p.add_argument("file", type=path, metavar="FILE_OR_FOLDER")
    p.add_argument("--json", action="store_true", help="as JSON, for programs; numbers with all digits")
    reading(p)


def _import(known: Verbs) -> None:
    p = add(known, "import", verbs.import_, "import a packing of another program (lengths are not rescaled)")
    text = "jamBashBulk text, jsrc or jax-md netCDF, GSD, LAMMPS data or dump, extended XYZ, H5MD"
    p.add_argument("file", type=path, metavar="FILE", help=f"{text}; also compressed by gzip, bzip2 or xz")
    reading(p)
    text = "minimise its energy again, at constant volume unless --pressure is given"
    p.add_argument("--relax", action="store_true", help=text)
    p.add_argument("--pressure", type=number, metavar="P", help="of --relax: target pressure, in units of k")
    p.add_argument("--shear-stabilised", action="store_true", help="of --relax: as for prepare")
    output(p, "OUT", "packing (HDF5, H5MD layout)", resume=False)


def _export(known: Verbs) -> None:
    text = "write packings, results and sheared runs for other programs, or as one flat table"
    p = add(known, "export", exports.export, text)
    p.add_argument("file", type=path, metavar="FILE_OR_FOLDER")
    text = (
        "of anything: csv or parquet, one flat table (a folder: all results, packings or runs in it); of a packing: "
        "xyz (extended XYZ, for OVITO and ASE), gsd (for HOOMD-blue, OVITO and freud), h5md (for MDAnalysis); of one "
        "modulus: csv (omega, G', G'' and their errors), tts (omega, G', G'' for RepTate), gt (t, G(t) for RepTate); "
        "of a sheared run: lammps (a folder with the input of the same disks); default: the extension of OUT, else "
        "xyz of a packing and csv"
    )
    p.add_argument("--to", metavar="FORMAT", help=text)
    text = "which result of a file with several; in a table and with --average a pattern, as 'N1024*'"
    p.add_argument("--group", metavar="NAME", help=text)
    text = "mean over packings, with scatter and standard error; unstable packings are left out"
    p.add_argument("--average", action="store_true", help=text)
    text = "tts, csv: frequencies in 1/tau1, instead of the stored ones: A:B:N or A,B,…"
    p.add_argument("--omega", type=Within(frequencies, ranges.OMEGA), metavar="RANGE", help=text)
    text = "gt: times in tau1: A:B:N or A,B,… (default ten per decade, inverse frequencies)"
    p.add_argument("--time", type=Within(points, ranges.TIME), metavar="RANGE", help=text)
    text = "lammps: strain of the LAMMPS run (default 1)"
    p.add_argument("--strain", type=Within(number, ranges.STRAIN), metavar="X", help=text)
    output(p, "OUT", "file to write (default: FILE with the extension of the format)", required=False, resume=False)


def _moduli(known: Verbs) -> None:
    p = add(known, "moduli", analyses.moduli, "complex modulus G*(omega) and its exact limits", RANKS)
    packings(p)
    text = (
        "angular frequencies in 1/tau1: A:B:N, evenly in log omega, both ends counted, or a list A,B,… "
        "(default 1e-8:1e2:61)"
    )
    p.add_argument("--omega", type=Within(frequencies, ranges.OMEGA), default="1e-8:1e2:61", metavar="RANGE", help=text)
    damping(p)
    strain(p)
    prestress(p)
    text = "frequencies in 1/tau1 at which displacements are stored (the nearest ones of --omega)"
    p.add_argument("--fields", type=Within(frequencies, ranges.OMEGA), default=(), metavar="RANGE", help=text)
    text = "mass of every disk, in k tau1^2: G* with inertia (default: none, overdamped)"
    p.add_argument("--mass", type=Within(number, ranges.INERTIA), metavar="M", help=text)
    text = (
        "bound on |dG*|/|G*| that the reduced model must meet from the lowest to the highest frequency (default 1e-6)"
    )
    p.add_argument("--rtol", type=number, metavar="X", help=text)
    text = "one factorisation for each frequency instead of the reduced model"
    p.add_argument("--direct", action="store_true", help=text)
    text = "one reduced model in (omega, beta) for all beta: its errors are estimates, not bounds"
    p.add_argument("--beta-family", action="store_true", help=text)
    team_size(p)
    p.add_argument("--out-of-core", action="store_true", help="store the factor on disk (MUMPS_OOC_TMPDIR)")
    text = "relative accuracy of a compressed factor, as 1e-9; refinement corrects the solutions (default 0: exact)"
    p.add_argument("--block-low-rank", type=Within(number, ranges.COMPRESSION), default=0.0, metavar="X", help=text)
    output(p, "OUT.h5", "results, one group for each packing")


def _shear(known: Verbs) -> None:
    text = "shear massive disks at a constant rate, in steps of the rate, or in oscillation (units ds, m, tau_e)"
    p = add(known, "shear", shearing.shear, text, RANKS)
    flow = p.add_argument_group("strain rate")
    text = "strain rates, in 1/tau_e: a list A,B,… or A:B:N (default 1e-4)"
    flow.add_argument("--rate", type=Within(numbers, ranges.RATE), metavar="X,…", help=text)
    text = "amount of shear strain (default 10)"
    flow.add_argument("--strain", type=Within(number, ranges.STRAIN), metavar="X", help=text)
    text = "continue at other strain rates; 0:TIME is rest, for a time in tau_e"
    flow.add_argument("--then", type=pairs, metavar="RATE:STRAIN,…", help=text)
    text = (
        "effect of a change of the strain rate: scale velocities and spins, add the change of the linear "
        "profile, or move only the boundary (default scale)"
    )
    flow.add_argument("--bulk", choices=BULK, help=text)
    text = "shear as gamma = AMPLITUDE sin(OMEGA t) instead, OMEGA in 1/tau_e"
    flow.add_argument("--oscillate", type=triple, metavar="AMPLITUDE:OMEGA:CYCLES", help=text)
    disks(p)


def _ramp(known: Verbs) -> None:
    text = "increase the strain rate in small steps, and decrease it again (VOT eqs. 38-41)"
    p = add(known, "ramp", shearing.ramp, text, RANKS)
    flow = p.add_argument_group("strain rate")
    text = "first strain rate, in 1/tau_e (default 1e-6)"
    flow.add_argument("--rate", type=Within(numbers, ranges.RATE_SIZE), metavar="X,…", help=text)
    text = "highest strain rate, in 1/tau_e (default 1e-3)"
    flow.add_argument("--to", type=Within(number, ranges.RATE_SIZE), default=1e-3, metavar="X", help=text)
    text = "decades in tau_e: the rate changes by 10^X every tau_e (default 1e-5)"
    flow.add_argument("--kappa", type=Within(number, ranges.KAPPA), default=1e-5, metavar="X", help=text)
    disks(p)


def _figure(known: Verbs) -> None:
    listing = "; ".join(f"{name}: {text}" for name, text in FIGURES.items())
    p = add(
        known,
        "figure",
        analyses.figure,
        "make a figure of one of both papers: packings or runs, results, picture and page",
        RANKS,
    )
    p.add_argument("name", metavar="NAME", help=listing)
    text = "small (default: minutes on two cores), medium (hours) or paper (sizes of the paper: hours to days)"
    p.add_argument("--preset", default="small", metavar="NAME", help=text)
    text = "other parameters than those of mpi_runs/NAME.toml, a table for each preset"
    p.add_argument("--parameters", type=path, metavar="FILE.toml", help=text)
    text = "prepare no packings and make no runs, use those in the folder"
    p.add_argument("--existing", action="store_true", help=text)
    engine(p)
    style(p)
    text = "folder of packings, runs, results, NAME.png, NAME.md and NAME.csv, for all figures (default runs/PRESET)"
    output(p, "FOLDER", text, required=False)


def _plot(known: Verbs) -> None:
    text = "draw a packing, a file of results, a sheared run, or a folder of packings or of runs (flow curves)"
    p = add(known, "plot", verbs.plot, text)
    p.add_argument("file", type=path, metavar="FILE_OR_FOLDER")
    text = "of a sheared run: packing fraction and strain rate around each disk in the last state (VOT fig. 27)"
    p.add_argument("--maps", action="store_true", help=text)
    style(p)
    output(
        p,
        "FIG.png",
        "figure (default: the same name with .png; the extension gives the format)",
        required=False,
        resume=False,
    )


def _report(known: Verbs) -> None:
    text = "write one page of HTML on a file or a folder: results, certificates, figures, numbers to download"
    p = add(known, "report", verbs.report, text)
    p.add_argument("file", type=path, metavar="FILE_OR_FOLDER")
    output(p, "REPORT.html", "page, complete in itself", resume=False)


def declare(p: Parser, kind: str) -> None:
    """Add the options of the verb that makes a kind of results.

    Parameters
    ----------
    p : Parser
    kind : str
        A name from ``KINDS``.
    """
    result = class_of(kind)
    verb: Verb = import_module(result.__module__).VERB
    packings(p)
    before = len(p._actions)
    verb.options(p)
    settings = [action.dest for action in p._actions[before:] if action.dest != "analyse"]
    if "damping" in result.settings or verb.laws:
        damping(p)
    if "strain" in result.settings:
        strain(p)
        settings.append("strain")
    if verb.stressed:
        p.set_defaults(prestress=[True])
    else:
        prestress(p)
    team_size(p)
    output(p, "OUT.h5", verb.output)
    p.set_defaults(analyse=verb.analyse, settings=settings, declared=(result, verb))


def style(p: Parser) -> None:
    """Add the look of a figure."""
    text = "pixels per inch (default 150)"
    p.add_argument("--dpi", type=Within(number, ranges.DPI), metavar="X", help=text)
    text = "style sheet of matplotlib, by its name (as dark_background) or its file; its settings count more than ours"
    p.add_argument("--style", metavar="NAME", help=text)


def reading(p: Parser) -> None:
    """Add the options for information that a file of another program may lack."""
    text = "which packing of a file with several, from 0 on (default 0)"
    p.add_argument("--index", type=Within(integer, ranges.INDEX), default=0, metavar="K", help=text)
    text = "contact potential, if the file does not contain it (default harmonic; for jsrc harmonic-relative)"
    p.add_argument("--potential", choices=POTENTIALS, help=text)
    text = "diameter of each type of disks, in the length unit of the file, for a file without radii, as 1:1.0,2:1.4"
    p.add_argument("--diameters", type=diameters, metavar="TYPE:X,…", help=text)


def packings(p: Parser) -> None:
    """Add the packings to work on."""
    p.add_argument("packings", type=path, nargs="+", metavar="PACKING", help="packings, or folders of them")


def disks(p: Parser) -> None:
    """Add the options of disks, model and integrator."""
    law = p.add_argument_group("model and forces")
    text = f"{', '.join(MODELS)} (default CD_rot); or a damping law, by the options below"
    law.add_argument("--model", type=lambda text: text.split(","), metavar="NAME,…", help=text)
    damping(law)
    text = "elasticity of collisions m/(kd tau_e): a list A,B,… or A:B:N (default 1)"
    law.add_argument("--Q", type=Within(numbers, ranges.Q), default="1", metavar="X,…", help=text)
    text = "exponent of the repulsion V ~ overlap^X (default 2, or that of --start)"
    law.add_argument("--exponent", type=Within(number, ranges.EXPONENT), metavar="X", help=text)
    text = "mass of every disk, in m; the friction coefficient m/(Q tau_e) does not change (default 1)"
    law.add_argument("--mass", type=Within(number, ranges.MASS), default=1.0, metavar="X", help=text)
    text = "Stokes drag on disks, in m/tau_e: force -X times the velocity relative to the affine flow (default 0)"
    law.add_argument("--stokes-drag", type=Within(number, ranges.DRAG), default=0.0, metavar="X", help=text)
    text = (
        "Stokes drag on their rotation, in m ds^2/tau_e: torque -X times the spin relative to that of the "
        "flow (default 0)"
    )
    law.add_argument("--rotational-drag", type=Within(number, ranges.DRAG), default=0.0, metavar="X", help=text)
    text = "exponent alpha of nonlinear drag of contacts: force ~ v^X (BT eq. 9), up to 1 (default 1: linear)"
    law.add_argument("--drag-exponent", type=Within(number, ranges.THINNING), default=1.0, metavar="X", help=text)
    text = "speed at which nonlinear drag is the linear one, in ds/tau_e (default d Q, d the mean diameter)"
    law.add_argument("--drag-speed", type=Within(number, ranges.SPEED), metavar="X", help=text)
    text = "speed below which nonlinear drag is linear, in ds/tau_e (default 0.01 d times the strain rate)"
    law.add_argument("--drag-cutoff", type=Within(number, ranges.SPEED), metavar="X", help=text)
    start = p.add_argument_group("disks and start")
    text = "numbers of disks, even (default 1024)"
    start.add_argument("--particles", type=Within(whole, ranges.SHEARED), metavar="N,…", help=text)
    text = "packing fractions: a list A,B,… or A:B:N, evenly (default 0.82)"
    start.add_argument("--phi", type=Within(evenly, ranges.PHI), metavar="X,…", help=text)
    either = start.add_mutually_exclusive_group()
    either.add_argument("--seed", type=Within(integer, ranges.SEED), help="seed of the random start (default 1)")
    text = "many seeds: A to B, both counted"
    either.add_argument("--seeds", type=Within(seeds, ranges.SEED), metavar="A:B", help=text)
    text = (
        "start from the end of a run, from a packing, or from the folder of a LAMMPS run (export --to "
        "lammps), not from random positions; several: a run from each"
    )
    start.add_argument("--start", type=path, nargs="+", metavar="FILE", default=[], help=text)
    text = "change cell and positions of --start to --phi; radii and peculiar velocities stay"
    start.add_argument("--rescale", action="store_true", help=text)
    text = (
        "make two shear bands of the start, the Bagnoldian one below: packing fraction and strain rate (1/tau_e) of "
        "each; they must average to --phi and, within 20 percent, to --rate"
    )
    start.add_argument("--start-bands", type=pairs, metavar="PHI_B:RATE_B,PHI_N:RATE_N", help=text)
    step = p.add_argument_group("time steps")
    text = "heun (VOT eqs. 21-24) or single: one evaluation of the forces in each step (default heun)"
    step.add_argument("--integrator", choices=INTEGRATORS, default="heun", help=text)
    text = (
        "time step in tau_e, divided if the contacts require it (default: one with an error of the energy budget "
        "below 1 percent, at most 0.05 for a mass of 1)"
    )
    step.add_argument("--dt", type=Within(number, ranges.DT), metavar="X", help=text)
    text = "threads of a run; useful from 10000 disks on (default 1)"
    step.add_argument("--threads", type=Within(integer, ranges.THREADS), default=1, metavar="T", help=text)
    engine(step)
    kept = p.add_argument_group("what is stored")
    text = "tau_e between rows of the time series, at least 50 steps (default a thousandth of the run; ramp: 1000)"
    kept.add_argument("--row-time", type=Within(number, ranges.ROW_TIME), metavar="X", help=text)
    text = "number of snapshots for OVITO, in the folder OUT.frames (default 0)"
    kept.add_argument("--frames", type=Within(integer, ranges.FRAMES), default=0, metavar="K", help=text)
    text = "keep the angles by which the disks have turned: in the file and in the frames"
    kept.add_argument("--angles", action="store_true", help=text)
    output(p, "RUN.h5", "the run, or a folder for several")


def damping(p: argparse._ActionsContainer) -> None:
    """Add the damping laws, every field of each."""
    p.add_argument("--damping", choices=LAWS, default="contact", help="viscous force law (default contact)")
    for law in LAWS.values():
        for item in fields(law):
            text = f"{law.name}: {item.metadata['help']}"
            if isinstance(item.default, bool):
                p.add_argument(option(item), dest=item.name, action="store_const", const=False, help=text)
            else:
                text += f"; a list A,B,… or A:B:N for several (default {item.default:g})"
                p.add_argument(
                    option(item), dest=item.name, type=Within(numbers, ranges.FRICTION), metavar="X,…", help=text
                )


def strain(p: Parser) -> None:
    """Add the mode of deformation."""
    text = "mode of deformation (default simple-shear)"
    p.add_argument("--strain-mode", dest="strain", choices=STRAINS, default="simple-shear", help=text)


def prestress(p: Parser) -> None:
    """Add the options for the terms of K."""
    either = p.add_mutually_exclusive_group()
    p.set_defaults(prestress=[True])
    text = "leave out the force term of K"
    either.add_argument("--no-prestress", dest="prestress", action="store_const", const=[False], help=text)
    text = "compute both, with and without the force term"
    either.add_argument("--prestress-both", dest="prestress", action="store_const", const=[True, False], help=text)


def team_size(p: Parser) -> None:
    """Add the option for the distribution of ranks."""
    text = "ranks that work together on one packing (default 1; more if packings are few or large)"
    p.add_argument("--team-size", type=Within(integer, ranges.RANKS), metavar="R", help=text)


def add(known: Verbs, verb: str, work: Work, text: str, epilog: str = "") -> Parser:
    """Add a verb whose options are known by name to :func:`misspelt`.

    Parameters
    ----------
    known : action of argparse
        What ``add_subparsers`` returns.
    verb : str
    work : callable
        Function of the options and of the communicator.
    text, epilog : str
        The help text, and its last line.
    """
    examples = [f"  petscjam {line}" for line in EXAMPLES.get(verb, ())]
    lines = [epilog.format(verb=verb), STATUS, *["Examples:"] * bool(examples), *examples]
    parser: Parser = known.add_parser(verb, help=text, description=text, epilog="\n".join(filter(None, lines)))
    parser.set_defaults(work=work, known=parser._option_string_actions.keys())
    parser.ended = False
    return parser


def messages(p: Parser) -> None:
    """Add the options that every verb has, the last group of its help."""
    common = p.add_argument_group("settings, messages")
    text = 'settings by the names of these options, as pressure = "1e-2:1e-4:9"; the command line counts more'
    common.add_argument("--config", type=path, metavar="FILE.toml", help=text)
    either = common.add_mutually_exclusive_group()
    text = "say version, ranks and time, and where in the program an error was found"
    either.add_argument("-v", "--verbose", action="store_true", help=text)
    either.add_argument("-q", "--quiet", action="store_true", help="say only warnings and errors")
    text = "append the command and all that it says to a file"
    common.add_argument("--log", type=path, metavar="FILE", help=text)


def output(p: Parser, metavar: str, text: str, *, required: bool = True, resume: bool = True) -> None:
    """Add ``-o`` and the options for an output that exists.

    Parameters
    ----------
    p : Parser
    metavar, text : str
        Its name in the help, and the help text.
    required, resume : bool
        Whether it must be given, and whether it can be resumed.
    """
    p.add_argument("-o", "--output", type=path, metavar=metavar, required=required, help=text)
    either = p.add_mutually_exclusive_group()
    either.add_argument("--overwrite", action="store_true", help="replace an output that exists")
    if resume:
        either.add_argument("--resume", action="store_true", help="continue with an output that exists")

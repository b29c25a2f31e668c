"""The command ``petscjam``: parse, call, print. Exit status 0 done, 2 bad input, 1 anything else."""

from __future__ import annotations

import argparse
import os
import resource
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import Field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

from petscjam.errors import InputError, SolverError
from petscjam.parallel.comm import exit_together, on_root

MOST = 1_000_000  # seeds, or frequencies
RANKS = "Runs in parallel: mpirun -n R petscjam {verb} …"


class Parser(argparse.ArgumentParser):
    """An argument parser that answers a mistake with one line."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**{"allow_abbrev": False, **kwargs})

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage."""
        raise InputError(f"{self.prog.removeprefix('petscjam ')}: {message}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status, the same on every rank."""
    # A rank that waits gives way to other work: on a shared machine up to five times faster (Open MPI).
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
    from mpi4py import MPI

    argv = list(sys.argv[1:] if arguments is None else arguments)
    leaving = MPI.COMM_WORLD.Dup()
    try:
        return run(argv, MPI.COMM_WORLD)
    except InputError as error:
        return exit_together(leaving, 2, f"petscjam: {error}")
    except SolverError as error:
        return exit_together(leaving, 1, f"petscjam: {error}")
    except KeyboardInterrupt:
        return exit_together(leaving, 1, "petscjam: interrupted")
    except Exception:
        return exit_together(leaving, 1, traceback.format_exc())
    finally:
        leaving.Free()


def run(argv: list[str], comm: Any) -> int:
    """Parse ``argv`` and do what it says."""
    from petscjam.parallel.petsc import set_options

    cut = argv.index("--") if "--" in argv else len(argv)
    set_options(argv[cut + 1 :])
    parser = build_parser()
    options, unknown = parser.parse_known_args(argv[:cut])
    if unknown:
        raise InputError(misspelt(unknown[0], options.known))
    options.work(options, comm)
    return 0


def misspelt(option: str, known: list[str]) -> str:
    """Say that ``option`` is unknown and what may have been meant."""
    close = get_close_matches(option.split("=")[0], known, 1)
    return f"unknown argument {option}" + (f"; did you mean {close[0]}?" if close else "")


def build_parser() -> Parser:
    """Return the parser of all verbs."""
    from petscjam.damping import LAWS
    from petscjam.kinematics import STRAINS
    from petscjam.storage import release

    parser = Parser(
        prog="petscjam",
        description="Linear response of jammed packings of soft disks, at every frequency.",
        epilog="PETSc options go after --, e.g. … -- -log_view. Units: stiffness k = 1, mean diameter d = 1, "
        "time tau1 = 1, unless a packing brings its own length unit.",
    )
    parser.add_argument("--version", action="version", version=f"petscjam {release('petscjam')}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=Parser)

    p = add(verbs, "prepare", prepare, "make packings of bidisperse disks at a target pressure", RANKS)
    p.add_argument("--particles", type=int, default=1024, metavar="N", help="number of disks (default 1024)")
    p.add_argument("--pressure", type=number, default=1e-3, metavar="P",
                   help="target pressure, in units of k (default 1e-3)")  # fmt: skip
    either = p.add_mutually_exclusive_group()
    either.add_argument("--seed", type=int, help="seed of the random start (default 1)")
    either.add_argument("--seeds", type=seeds, metavar="A:B", help="many seeds, A to B, both counted")
    p.add_argument("--method", choices=["cg", "fire"], default="cg",
                   help="minimiser: nonlinear conjugate gradients or FIRE (default cg)")  # fmt: skip
    p.add_argument("--shear-stabilised", action="store_true", help="not available yet")
    output(p, "FILE_OR_FOLDER", "packing (HDF5, H5MD layout), or the folder for several")

    p = add(verbs, "info", info, "say what a packing or a result holds")
    p.add_argument("file", type=Path, metavar="FILE")

    p = add(verbs, "import", import_, "turn another program's packing into ours (no rescaling)")
    p.add_argument("file", type=Path, metavar="FILE", help="jamBashBulk text, jax-md netCDF, extended XYZ")
    p.add_argument("--index", type=int, default=0, help="which packing of a file with several (default 0)")
    output(p, "OUT", "packing (HDF5, H5MD layout)", resume=False)

    p = add(verbs, "export", export, "write a packing for other programs")
    p.add_argument("file", type=Path, metavar="FILE")
    p.add_argument("--to", default="xyz", metavar="FORMAT", help="xyz: extended XYZ, for OVITO and ASE")
    output(p, "OUT", "file to write (default: FILE with the format's ending)", required=False, resume=False)

    p = add(verbs, "moduli", moduli, "complex modulus G*(omega) and its exact limits", RANKS)
    p.add_argument("packings", type=Path, nargs="+", metavar="PACKING", help="packings, or folders of them")
    p.add_argument("--omega", type=frequencies, default="1e-8:1e2:61", metavar="RANGE",
                   help="angular frequencies in 1/tau1: A:B:N, evenly in log omega, both ends counted, "
                        "or a list A,B,… (default 1e-8:1e2:61)")  # fmt: skip
    p.add_argument("--damping", choices=LAWS, default="contact", help="viscous force law (default contact)")
    for law in LAWS.values():
        for item in fields(law):
            text = f"{law.name}: {item.metadata['help']}"
            if isinstance(item.default, bool):
                p.add_argument(option(item), dest=item.name, action="store_const", const=False, help=text)
            else:
                text += f" (default {item.default:g})"
                p.add_argument(option(item), dest=item.name, type=number, metavar="X", help=text)
    p.add_argument("--strain", choices=STRAINS, default="simple-shear",
                   help="mode of deformation (default simple-shear)")  # fmt: skip
    p.add_argument("--no-prestress", action="store_true", help="leave out the forces of the initial state")
    p.add_argument("--fields", type=frequencies, default=(), metavar="RANGE",
                   help="frequencies of the sweep (nearest point) whose displacements are kept")  # fmt: skip
    p.add_argument("--direct", action="store_true",
                   help="one factorisation a frequency (for now the only way)")  # fmt: skip
    output(p, "OUT.h5", "results, one group a packing")

    p = add(verbs, "plot", plot, "draw G' and G'' and the displacement fields of a result")
    p.add_argument("file", type=Path, metavar="RESULT.h5")
    output(p, "FIG.png", "figure (default: RESULT.png; the ending picks the format)",
           required=False, resume=False)  # fmt: skip
    return parser


def add(verbs: Any, verb: str, work: Callable, text: str, epilog: str = "") -> Parser:
    """Add a verb whose options are known by name to :func:`misspelt`."""
    parser = verbs.add_parser(verb, help=text, description=text, epilog=epilog.format(verb=verb))
    parser.set_defaults(work=work, known=parser._option_string_actions.keys())
    return parser


def output(p: Parser, metavar: str, text: str, *, required: bool = True, resume: bool = True) -> None:
    """Add ``-o`` and what to do if it exists."""
    p.add_argument("-o", "--output", type=Path, metavar=metavar, required=required, help=text)
    either = p.add_mutually_exclusive_group()
    either.add_argument("--overwrite", action="store_true", help="replace an output that exists")
    if resume:
        either.add_argument("--resume", action="store_true", help="go on with an output that exists")


def number(text: str) -> float:
    """Parse a finite number."""
    import math

    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def seeds(text: str) -> range:
    """Parse ``A:B``, both counted."""
    try:
        first, last = (int(part) for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a range A:B of whole numbers") from None
    if last < first:
        raise argparse.ArgumentTypeError(f"{text!r} is an empty range")
    if last - first >= MOST:
        raise argparse.ArgumentTypeError(f"{text!r} has more than {MOST} seeds")
    return range(first, last + 1)


def frequencies(text: str) -> Any:
    """Parse ``A:B:N`` (evenly in the logarithm, both ends) or ``A,B,…``, all > 0."""
    import numpy as np

    from petscjam.response.moduli import frequencies as checked

    try:
        if ":" not in text:
            return checked([float(part) for part in text.split(",")])
        first, last, count = text.split(":")
        ends = checked([float(first), float(last)])
        if int(count) < 1 or (ends[1] < ends[0]):
            raise InputError(f"omega: the range {text} is empty")
        if int(count) > MOST:
            raise InputError(f"omega: the range {text} has more than {MOST} points")
        if int(count) == 1 and ends[0] != ends[1]:
            raise InputError(f"omega: the range {text} has two ends but one point")
        return np.geomspace(ends[0], ends[1], int(count))
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither A:B:N nor a list A,B,…") from None


def option(item: Field) -> str:
    """Return the option of a field of a law; one that is on by default is turned off."""
    return f"--{'no-' * isinstance(item.default, bool)}{item.name.replace('_', '-')}"


def chosen_law(options: argparse.Namespace) -> Any:
    """Return the damping law that the options describe; an option of another law is refused."""
    from petscjam.damping import LAWS

    law, settings = LAWS[options.damping], {}
    for other in LAWS.values():
        for item in fields(other):
            value = getattr(options, item.name)
            if value is None:
                continue
            if item.name not in [own.name for own in fields(law)]:
                raise InputError(f"{option(item)} goes with --damping {other.name}, not with {law.name}")
            settings[item.name] = value
    return law(**settings)


def say(comm: Any, text: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(text, flush=True)


def prepare(options: argparse.Namespace, comm: Any) -> None:
    """Deal the seeds to the ranks."""
    from petscjam.packing.packing import Packing
    from petscjam.packing.prepare import prepare_packing
    from petscjam.progress import part, progress
    from petscjam.storage import check_output, naming

    one = 1 if options.seed is None else options.seed
    many, target = options.seeds or [one], options.output
    folder = options.seeds is not None or target.is_dir()
    names = {seed: f"N{options.particles}_p{options.pressure:g}_s{seed:04d}.h5" for seed in many}
    files = {seed: target / names[seed] if folder else target for seed in many}

    def made(file: Path, seed: int) -> bool:
        if not file.exists():
            return False
        there = Packing.read(file).provenance
        wanted = {
            "n": options.particles, "pressure": options.pressure, "seed": seed, "method": options.method,
        }  # fmt: skip
        for key, value in wanted.items():
            if there.get(key) != value:
                raise InputError(f"{file}: has {key} = {there.get(key)}, not {value}; it cannot be resumed")
        return True

    def left() -> list[int]:
        if folder:
            with naming(target):
                target.mkdir(parents=True, exist_ok=True)
        todo = [seed for seed in many if not (options.resume and made(files[seed], seed))]
        for seed in todo:
            check_output(files[seed], overwrite=options.overwrite)
        return todo

    todo = on_root(comm, left)
    mine = todo[comm.rank :: comm.size]
    with progress("prepare", show=comm.rank == 0) as report:
        for k, seed in enumerate(mine):
            packing = prepare_packing(
                options.particles, options.pressure, seed,
                method=options.method, shear_stabilised=options.shear_stabilised,
                progress=part(report, k, len(mine)),
            )  # fmt: skip
            packing.write(files[seed], overwrite=True)
    comm.Barrier()
    say(comm, f"{len(todo)} prepared, {len(many) - len(todo)} there already: {target}")


def info(options: argparse.Namespace, comm: Any) -> None:
    """Print what a file holds."""

    def text() -> str:
        from petscjam.io.importers import import_packing
        from petscjam.io.results import is_result, read_moduli
        from petscjam.report import describe_packing, table

        if is_result(options.file):
            return table(read_moduli(options.file))
        return describe_packing(import_packing(options.file))

    say(comm, on_root(comm, text))


def import_(options: argparse.Namespace, comm: Any) -> None:
    """Import a packing."""

    def work() -> None:
        from petscjam.io.importers import import_packing
        from petscjam.storage import check_output

        check_output(options.output, overwrite=options.overwrite, inputs=[options.file])
        packing = import_packing(options.file, options.index)
        packing.write(options.output, overwrite=options.overwrite)
        print(f"{options.output}: {len(packing)} disks, phi = {packing.phi:.6f}")

    on_root(comm, work)


def export(options: argparse.Namespace, comm: Any) -> None:
    """Export a packing."""

    def work() -> None:
        from petscjam.io.exporters import export_packing
        from petscjam.io.importers import import_packing
        from petscjam.storage import check_output

        target = options.output or options.file.with_suffix(f".{options.to}")
        check_output(target, overwrite=options.overwrite, inputs=[options.file])
        export_packing(import_packing(options.file), target, options.to, overwrite=options.overwrite)
        print(target)

    on_root(comm, work)


def packings_of(given: Path) -> list[Path]:
    """Return the file itself, or the packings of a folder; results that lie among them are not meant."""
    from petscjam.io.results import is_result

    return [file for file in sorted(given.glob("*.h5")) if not is_result(file)] if given.is_dir() else [given]


def moduli(options: argparse.Namespace, comm: Any) -> None:
    """Sweep packing after packing, the ranks together; each result is written as it comes."""
    import numpy as np

    from petscjam.io.importers import import_packing
    from petscjam.io.results import append_modulus, done, group_name, read_moduli
    from petscjam.progress import part, progress
    from petscjam.report import table
    from petscjam.response.moduli import complex_modulus
    from petscjam.storage import check_output

    damping, omega = chosen_law(options), options.omega
    for w in options.fields:
        if not omega.min() <= w <= omega.max():
            raise InputError(f"--fields {w:g} lies outside the sweep")
    nearest = [np.argmin(np.abs(np.log(omega / w))) for w in options.fields]
    kept = omega[np.unique(np.array(nearest, dtype=int))]
    settings = {"damping": str(damping), "strain": options.strain, "prestress": not options.no_prestress}

    def files_and_groups_done() -> tuple[list[Path], set[str]]:
        files = [file for given in options.packings for file in packings_of(given)]
        for file in files:
            if not file.exists():
                raise InputError(f"{file}: no such file")
        if not files:
            raise InputError(f"{options.packings[0]}: no packings in this folder")
        check_output(options.output, overwrite=options.overwrite or options.resume, inputs=files)
        if options.resume and options.output.exists():
            return files, done(options.output, settings, omega, kept)
        return files, set()

    files, groups = on_root(comm, files_and_groups_done)
    fresh = options.overwrite
    with progress("moduli", show=comm.rank == 0) as report:
        for k, file in enumerate(files):
            packing = on_root(comm, import_packing, file)
            group = group_name(packing, file.stem)
            if group in groups:
                continue
            result = complex_modulus(
                packing, omega, damping=damping, strain=options.strain, prestress=settings["prestress"],
                comm=comm, fields_at=kept, name=file.stem,
                progress=part(report, k, len(files), f"{file.stem}: "),
            )  # fmt: skip
            on_root(comm, append_modulus, result, options.output, group, fresh=fresh)
            groups.add(group)
            fresh = False
    say(comm, on_root(comm, lambda: table(read_moduli(options.output))))
    peaks = comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    say(comm, f"peak memory of each rank: {' '.join(f'{peak:.0f}' for peak in peaks or [])} MB")


def plot(options: argparse.Namespace, comm: Any) -> None:
    """Draw a result."""

    def work() -> None:
        from petscjam.io.results import read_moduli
        from petscjam.plots import plot_moduli
        from petscjam.storage import check_output

        target = options.output or options.file.with_suffix(".png")
        results = read_moduli(options.file)
        check_output(target, overwrite=options.overwrite, inputs=[options.file])
        plot_moduli(results, target)
        print(target)

    on_root(comm, work)

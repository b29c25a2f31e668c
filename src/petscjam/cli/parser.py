"""The options of every verb, and one line for every mistake."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

from petscjam.cli import verbs
from petscjam.cli.laws import option
from petscjam.damping import LAWS
from petscjam.errors import InputError
from petscjam.kinematics import STRAINS
from petscjam.storage import release

MOST = 1_000_000  # seeds, or frequencies
RANKS = "Runs in parallel: mpirun -n R petscjam {verb} …"


class Parser(argparse.ArgumentParser):
    """An argument parser that answers a mistake with one line."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**{"allow_abbrev": False, **kwargs})

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage."""
        raise InputError(f"{self.prog.removeprefix('petscjam').strip() or 'command line'}: {message}")


def misspelt(option: str, known: list[str]) -> str:
    """Say that ``option`` is unknown and what may have been meant."""
    close = get_close_matches(option.split("=")[0], known, 1)
    return f"unknown argument {option}" + (f"; did you mean {close[0]}?" if close else "")


def build_parser() -> Parser:
    """Return the parser of all verbs."""
    parser = Parser(
        prog="petscjam",
        description="Linear response of jammed packings of soft disks, at every frequency.",
        epilog="PETSc options go after --, e.g. … -- -log_view. Units: stiffness k = 1, mean diameter d = 1, "
        "time tau1 = 1, unless a packing brings its own length unit.",
    )
    parser.add_argument("--version", action="version", version=f"petscjam {release('petscjam')}")
    known = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=Parser)

    p = add(known, "prepare", verbs.prepare, "make packings of bidisperse disks at a target pressure", RANKS)
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

    p = add(known, "info", verbs.info, "say what a packing or a result holds")
    p.add_argument("file", type=Path, metavar="FILE")

    p = add(known, "import", verbs.import_, "turn another program's packing into ours (no rescaling)")
    p.add_argument("file", type=Path, metavar="FILE", help="jamBashBulk text, jax-md netCDF, extended XYZ")
    p.add_argument("--index", type=int, default=0, help="which packing of a file with several (default 0)")
    output(p, "OUT", "packing (HDF5, H5MD layout)", resume=False)

    p = add(known, "export", verbs.export, "write a packing for other programs")
    p.add_argument("file", type=Path, metavar="FILE")
    p.add_argument("--to", default="xyz", metavar="FORMAT", help="xyz: extended XYZ, for OVITO and ASE")
    output(p, "OUT", "file to write (default: FILE with the format's ending)", required=False, resume=False)

    p = add(known, "moduli", verbs.moduli, "complex modulus G*(omega) and its exact limits", RANKS)
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

    p = add(known, "plot", verbs.plot, "draw G' and G'' and the displacement fields of a result")
    p.add_argument("file", type=Path, metavar="RESULT.h5")
    output(p, "FIG.png", "figure (default: RESULT.png; the ending picks the format)",
           required=False, resume=False)  # fmt: skip
    return parser


def add(known: Any, verb: str, work: Callable, text: str, epilog: str = "") -> Parser:
    """Add a verb whose options are known by name to :func:`misspelt`."""
    parser = known.add_parser(verb, help=text, description=text, epilog=epilog.format(verb=verb))
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

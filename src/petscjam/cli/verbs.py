"""What each verb does: read, call, write, print."""

from __future__ import annotations

import argparse
import resource
from pathlib import Path
from typing import Any

from petscjam.cli.laws import chosen_law
from petscjam.errors import InputError
from petscjam.parallel.comm import on_root


def say(comm: Any, text: str) -> None:
    """Print on rank 0."""
    if comm.rank == 0:
        print(text, flush=True)


def prepare(options: argparse.Namespace, comm: Any) -> None:
    """Deal the seeds to the ranks."""
    from petscjam.packing.packing import Packing
    from petscjam.packing.prepare import check, prepare_packing
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
        for seed in many:
            check(options.particles, options.pressure, seed, options.shear_stabilised, options.method)
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
    from petscjam.storage import check_output, naming

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
            with naming(file):
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

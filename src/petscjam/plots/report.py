"""A page of HTML on a file or a folder, complete in itself: pictures and numbers are data: URIs, without scripts."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from html import escape
from inspect import getdoc
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from petscjam.base.errors import InputError, readable
from petscjam.base.files import check_output, write_atomically
from petscjam.base.interrupt import check
from petscjam.base.tables import Table, html_table, in_short
from petscjam.base.versions import release
from petscjam.geometry.packing import Packing
from petscjam.io.kinds import KINDS, kind_of, recognise
from petscjam.io.results import inventory
from petscjam.io.tidy import of_results, of_runs
from petscjam.md.result import Run
from petscjam.plots.files import CONTENTS
from petscjam.preparation.library import Library
from petscjam.response.origin import Judged, Result

COMMAND = re.compile(r"^\d{4}-\d\d-\d\dT\S+ (petscjam .*)$", re.MULTILINE)
MOST_LINES = 200  # of a table on the page; the download has all
MOST_BYTES = 2**25  # of a download
STYLE = """
:root { color-scheme: light dark; --line: #ccc; --soft: #f4f5f7; --text: #1c1e21; --page: #fff; --link: #1f5fa8 }
@media (prefers-color-scheme: dark) {
  :root { --line: #444; --soft: #24272b; --text: #e4e6e9; --page: #16181b; --link: #8ab4f0 }
}
body { margin: 0; background: var(--page); color: var(--text); font: 16px/1.5 system-ui, sans-serif }
main { max-width: 60rem; margin: 0 auto; padding: 1.5rem }
h1, h2, h3 { line-height: 1.2; overflow-wrap: anywhere }
section { border-top: 1px solid var(--line); margin-top: 2rem }
a { color: var(--link) }
figure { margin: 1rem 0; text-align: center; overflow-x: auto }
img { min-width: 30rem; max-width: 100%; height: auto; background: #fff; border-radius: 4px }
figcaption { font-size: 0.9rem }
.wide, pre { overflow-x: auto }
pre { background: var(--soft); padding: 0.8rem; font-size: 0.8rem; border-radius: 4px }
table { border-collapse: collapse; font-size: 0.85rem }
th, td { border-bottom: 1px solid var(--line); padding: 0.2rem 0.6rem; text-align: left; white-space: nowrap }
td { font-variant-numeric: tabular-nums }
.warning { border-left: 4px solid #c8551b; padding-left: 0.8rem }
@media print { a[download] { display: none } }
"""


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Attributes
    ----------
    title : str
        Plain text.
    blocks : tuple of str
        HTML.
    """

    title: str
    blocks: tuple[str, ...]


def write_report(path: str | PathLike[str], output: str | PathLike[str], *, overwrite: bool = False) -> list[str]:
    """Write a page on a file or a folder: what was computed, of which packings, certificates, figures, numbers.

    Parameters
    ----------
    path : path
        A packing, results, a sheared run, or a folder; the folders in it have sections, too.
    output : path
        Of the page, ``.html``.
    overwrite : bool

    Returns
    -------
    list of str
        Files of a folder that cannot be read; the page names them.

    Raises
    ------
    InputError
        If nothing can be read, or the output exists or is no ``.html``.
    """
    path, output = Path(path), Path(output)
    if output.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"report: {output}: a report is a page of HTML; choose a name that ends in .html")
    check_output(output, overwrite=overwrite, inputs=[path])
    sections, failed = ([*_file(path)], []) if path.is_file() else _folder(path)
    if not sections:
        raise InputError(f"{path}: there is nothing to report on{''.join(f'; {text}' for text in failed)}")
    write_atomically(output, _page(path.absolute().name, sections, failed).encode())
    return failed


def _folder(path: Path) -> tuple[list[Section], list[str]]:
    """Return the sections of a folder and of the folders in it, and the files that cannot be read."""
    sections: list[Section] = []
    failed: list[str] = []

    def add(make: Callable[[Path], Iterable[Section]], given: Path) -> None:
        check()
        try:
            sections.extend(make(given))
        except InputError as error:
            failed.append(str(error))

    if not path.exists():
        raise InputError(f"{path}: there is no such file or folder")
    for folder in [path, *sorted(one for one in path.rglob("*") if one.is_dir())]:
        kinds: dict[Path, str] = {}
        for file in sorted(folder.glob("*.h5")):
            try:
                kinds[file] = recognise(file)
            except InputError as error:
                failed.append(str(error))
        several = {kind for kind in ("packing", "run") if list(kinds.values()).count(kind) > 1}
        if several:
            add(_of("runs" if "run" in several else "library"), folder)
        for file, kind in kinds.items():
            if kind not in several or (kind == "packing" and "run" in several):
                add(_of(kind), file)
        for page in sorted(folder.glob("*.md")):
            if page.with_suffix(".png").exists():
                add(_figure_of_a_paper, page)
    commands = [line for log in sorted(path.rglob("*.log")) for line in _commands(log)]
    if commands and sections:
        said = escape("\n".join(commands))
        sections.append(Section("Commands", (f"<p>As recorded by --log.</p><pre>{said}</pre>",)))
    return sections, list(dict.fromkeys(failed))


def _commands(log: Path) -> list[str]:
    """Return the commands in a file of ``--log``."""
    return COMMAND.findall(log.read_text(encoding="utf-8", errors="replace"))


def _file(path: Path) -> Iterator[Section]:
    yield from _of(recognise(path))(path)


def _of(kind: str) -> Callable[[Path], Iterator[Section]]:
    """Return the function from a file or a folder of this kind to its sections."""

    def make(path: Path) -> Iterator[Section]:
        contents = CONTENTS[kind]
        found = contents.read(path)
        blocks = [*WRITERS[kind](found, path)]
        said = escape(contents.describe(found))
        blocks.append(f"<details><summary>As printed by petscjam info</summary><pre>{said}</pre></details>")
        yield Section(readable(path.absolute().name), (*blocks[:1], _drawn(kind, found, path), *blocks[1:]))

    return make


def _results(results: Mapping[str, Result], path: Path) -> Iterator[str]:
    if not results:
        yield "<p>There are no results in this file yet.</p>"
        return
    cls = type(next(iter(results.values())))
    kind = KINDS[kind_of(cls)]
    text = kind.text or (getdoc(cls) or "").partition("\n")[0].partition(". ")[0]
    yield f"<p><strong>{escape(text)}</strong>: {len(results)} result{'s' * (len(results) != 1)}.</p>"
    doubts = [f"{name}: {r.state}" for name, r in results.items() if isinstance(r, Judged) and not r.stable]
    yield from _warnings(doubts)
    yield "<h3>Results</h3>"
    if cls.units:
        yield f"<p>{escape(cls.units)}</p>"
    yield from _table(Table.of_rows({"result": name, **r.facts()} for name, r in results.items()))
    notes = [f"{name}: {note}" for name, r in results.items() for note in r.notes]
    if notes:
        yield f"<ul>{''.join(f'<li>{escape(note)}</li>' for note in notes)}</ul>"
    yield "<h3>Packings</h3>"
    yield from _table(Table.of_rows(_origins(results)))
    with suppress(InputError):  # a file of a reduced model has no inventory
        made = sorted({item.made_with for item in inventory(path)} - {""})
        if made:
            yield f"<h3>Made with</h3><pre>{escape(chr(10).join(made))}</pre>"
    yield _download(path, of_results(results))


def _origins(results: Mapping[str, Result]) -> Iterator[dict[str, Any]]:
    """Yield a line for each packing of the results."""
    seen = set()
    for r in results.values():
        if r.origin.checksum not in seen:
            seen.add(r.origin.checksum)
            left_out = ("prestress", "strain", "damping")
            yield {item.name: getattr(r.origin, item.name) for item in fields(r.origin) if item.name not in left_out}


def _packing(packing: Packing, path: Path) -> Iterator[str]:
    yield f"<p><strong>Packing of {len(packing)} disks</strong>, checksum {packing.checksum}.</p>"
    c = packing.certificate
    if c.proved is not True:
        yield from _warnings(["not a proved minimum" if c.proved is False else "not certified"])
    yield "<h3>Certificate</h3>"
    facts = {**packing.facts(), **{name: value for name, value in asdict(c).items() if value is not None}}
    yield _wide(html_table((name.replace("_", " "), in_short(value)) for name, value in facts.items()))
    if packing.provenance:
        yield "<h3>Made with</h3>"
        yield _wide(html_table((str(name), in_short(value)) for name, value in packing.provenance.items()))
    yield _download(path, packing.flat())


def _library(library: Library, path: Path) -> Iterator[str]:
    rows = library.rows
    proved = sum(row["proved"] is True for row in rows)
    yield f"<p><strong>{len(rows)} packings</strong>, {proved} of them proved minima; {len(library.failed)} failed.</p>"
    yield from _warnings([f"{row['file']}: {row['failure']}" for row in library.failed])
    yield "<h3>Certificates</h3>"
    yield from _table(library.flat())
    if library.recipe:
        yield "<h3>Made with</h3>"
        yield _wide(html_table((str(name), in_short(value)) for name, value in library.recipe.items()))
    yield _download(path, library.flat())


def _run(run: Run, path: Path) -> Iterator[str]:
    yield f"<p><strong>Sheared run</strong>: {run.settings.particles} disks, {escape(run.settings.model.name)}.</p>"
    yield from _warnings(run.warnings)
    yield "<h3>Means</h3>"
    yield _wide(html_table((name, in_short(value)) for name, value in run.facts().items()))
    yield "<h3>Made with</h3>"
    yield _wide(html_table((name, in_short(value)) for name, value in run.settings.attributes.items()))
    yield _download(path, run.flat())


def _runs(runs: Mapping[str, Run], path: Path) -> Iterator[str]:
    yield f"<p><strong>{len(runs)} sheared runs</strong></p>"
    yield from _warnings([f"{name}: {text}" for name, run in runs.items() for text in run.warnings])
    yield "<h3>Means</h3>"
    yield from _table(Table.of_rows({"run": name, **run.facts()} for name, run in runs.items()))
    yield "<h3>Made with</h3>"
    yield from _table(Table.of_rows({"run": name, **run.settings.attributes} for name, run in runs.items()))
    yield _download(path, of_runs(runs))


WRITERS: dict[str, Callable[[Any, Path], Iterator[str]]] = {
    "results": _results,
    "packing": _packing,
    "library": _library,
    "run": _run,
    "runs": _runs,
}


def _figure_of_a_paper(page: Path) -> Iterator[Section]:
    picture, numbers = page.with_suffix(".png"), page.with_suffix(".csv")
    blocks = [_image(picture.read_bytes(), page.stem), f"<pre>{escape(page.read_text(errors='replace'))}</pre>"]
    if numbers.exists():
        blocks.append(_link(numbers.name, numbers.read_bytes()))
    yield Section(f"Figure {readable(page.stem)}", tuple(blocks))


def _drawn(kind: str, found: Any, path: Path) -> str:
    """Return the figure of a content as HTML, or the reason why there is none."""
    with TemporaryDirectory() as folder:
        picture = Path(folder, "figure.png")
        try:
            CONTENTS[kind].draw(found, picture)
        except InputError as error:
            return f"<p>No figure: {escape(str(error))}.</p>"
        return _image(picture.read_bytes(), readable(path.absolute().name))


def _image(picture: bytes, name: str) -> str:
    text = escape(name, quote=True)
    source = f"data:image/png;base64,{b64encode(picture).decode()}"
    return f'<figure><img src="{source}" alt="figure of {text}"><figcaption>{text}</figcaption></figure>'


def _table(table: Table) -> Iterator[str]:
    """Yield what is the same on all lines, and a table of the rest with at most ``MOST_LINES`` lines."""
    columns = {name: [in_short(value) for value in column] for name, column in table.columns.items()}
    same = {name: column[0] for name, column in columns.items() if len(table) > 1 and len(set(column)) == 1}
    if same:
        yield f"<p>The same for all: {escape('; '.join(f'{name} {value}' for name, value in same.items()))}.</p>"
    first = Table({name: column[:MOST_LINES] for name, column in columns.items() if name not in same}, table.units)
    yield _wide(first.html())
    if len(table) > MOST_LINES:
        yield f"<p>{len(table) - MOST_LINES} more lines are in the download.</p>"


def _wide(table: str) -> str:
    return f'<div class="wide">{table}</div>'


def _warnings(texts: Iterable[str]) -> Iterator[str]:
    texts = list(texts)
    if texts:
        yield f'<ul class="warning">{"".join(f"<li>{escape(text)}</li>" for text in texts)}</ul>'


def _download(path: Path, table: Table) -> str:
    """Return a link with the table as CSV."""
    return _link(f"{readable(path.absolute().stem)}.csv", table.to_csv())


def _link(name: str, content: bytes) -> str:
    text = escape(name, quote=True)
    if len(content) > MOST_BYTES:
        return f"<p>{text}: {len(content) / 1e6:.0f} MB, too large for this page; petscjam export writes it.</p>"
    source = f"data:text/csv;base64,{b64encode(content).decode()}"
    return f'<p><a download="{text}" href="{source}">{text}</a> ({max(1, round(len(content) / 1e3))} kB)</p>'


def _page(name: str, sections: list[Section], failed: list[str]) -> str:
    title = escape(f"Report on {readable(name)}")
    links = "".join(f'<li><a href="#s{k}">{escape(one.title)}</a></li>' for k, one in enumerate(sections))
    body = [
        f'<section id="s{k}">\n<h2>{escape(one.title)}</h2>\n{chr(10).join(one.blocks)}\n</section>'
        for k, one in enumerate(sections)
    ]
    lost = [f"<p>Not read:</p>{one}" for one in _warnings(failed)]
    contents = [f"<nav><ul>{links}</ul></nav>"] * (len(sections) > 1)
    units = "stress in k, time in τ1 and length in mean diameters, if no other units are given"
    made = f"<p>Made by petscjam {escape(release('petscjam'))}. Units: {units}.</p>"
    head = f'<meta charset="utf-8">\n<meta name="viewport" content="width=device-width">\n<title>{title}</title>'
    inside = "\n".join([f"<h1>{title}</h1>", made, *contents, *lost, *body])
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n{head}\n<style>{STYLE}</style>\n</head>\n'
        f"<body>\n<main>\n{inside}\n</main>\n</body>\n</html>\n"
    )

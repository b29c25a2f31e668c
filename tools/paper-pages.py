"""Copy what `petscjam figure` found into the docs: python tools/paper-pages.py runs/medium [TAG].

A page has its results between <!-- results: NAME --> and <!-- end of results -->.
"""

import csv
import re
import sys
from pathlib import Path

from PIL import Image

END = "<!-- end of results -->"


def summary(tables: list[Path]) -> str:
    """Return all numbers of VOT that have a value in the paper, as a table, and the runs of each set."""
    lines = ["| figure | quantity | here | paper |", "|---|---|---|---|"]
    for table in tables:
        with table.open() as file:
            for row in csv.DictReader(file):
                if row["paper"] and not row["x"]:
                    value, error = float(row["value"]), float(row["error"])
                    here = "—" if value != value else f"{value:.3g}" + ("" if error != error else f" ± {error:.1g}")
                    lines.append(
                        f"| [fig. {table.stem[3:]}]({table.stem}.md) | {row['quantity']} | {here} | {row['paper']} |"
                    )
    runs: dict[str, str] = {}  # by set: the line of the figure with most runs
    for table in tables:
        for line in re.findall(r"^- \d+ runs of the set .*", table.with_suffix(".md").read_text(), re.M):
            count, name = re.match(r"- (\d+) runs of the set (\w+)", line).groups()
            if name not in runs or int(count) > int(runs[name].split()[1]):
                runs[name] = line
    return "\n".join([*lines, "", *runs.values(), ""])


def put(name: str, text: str) -> None:
    """Put results into the page that has a place for them."""
    for page in (docs / "paper").glob("*.md"):
        before, mark, rest = page.read_text().partition(f"<!-- results: {name} -->\n")
        if mark:
            page.write_text(f"{before}{mark}\n{text.strip()}\n\n{END}{rest.partition(END)[2]}")
            return
    raise SystemExit(f"no page of docs/paper has <!-- results: {name} -->")


source, docs = Path(sys.argv[1]), Path(__file__).parents[1] / "docs"
suffix = "" if len(sys.argv) < 3 else f"-{sys.argv[2]}"
for page in sorted(source.glob("*.md")):
    put(page.stem + suffix, page.read_text())
    for picture in [source / f"{page.stem}.png", *source.glob(f"{page.stem}-*.png")]:
        image = Image.open(picture).convert("RGB").quantize(128)
        image.save(docs / "figures" / f"{picture.stem}{suffix}.png", optimize=True)
if tables := sorted(source.glob("vot*.csv"), key=lambda path: int(path.stem[3:])):
    put(f"vot{suffix}", summary(tables))

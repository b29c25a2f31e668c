"""Copy what `petscjam figure` found into the docs: python tools/paper-pages.py runs/medium [TAG]."""

import sys
from pathlib import Path

from PIL import Image

source, docs = Path(sys.argv[1]), Path(__file__).parents[1] / "docs"
suffix = "" if len(sys.argv) < 3 else f"-{sys.argv[2]}"
(docs / "paper" / "results").mkdir(parents=True, exist_ok=True)
for page in sorted(source.glob("*.md")):
    (docs / "paper" / "results" / f"{page.stem}{suffix}.md").write_text(page.read_text())
    for picture in sorted(source.glob(f"{page.stem}*.png")):
        image = Image.open(picture).convert("RGB").quantize(128)
        image.save(docs / "figures" / f"{picture.stem}{suffix}.png", optimize=True)

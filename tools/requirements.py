"""Print what pip has to install: build requirements, dependencies and the extras named as arguments.

h5py and mpi4py are left out, because Debian brings them. Debian calls its h5py "h5py.-debian-h5py-mpi",
so pip believes h5py is missing and would put a serial one from PyPI in front of Debian's parallel one.
"""

import re
import sys
import tomllib
from pathlib import Path

DEBIAN_BRINGS = {"h5py", "mpi4py"}

config = tomllib.loads(Path("pyproject.toml").read_text())
project = config["project"]
wanted = config["build-system"]["requires"] + project["dependencies"]
for extra in sys.argv[1:]:
    wanted += project["optional-dependencies"][extra]
print("\n".join(line for line in wanted if re.split(r"[^\w-]", line)[0] not in DEBIAN_BRINGS))

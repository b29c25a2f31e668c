"""``python -m petscjam``: the command ``petscjam``."""

import sys

from petscjam.cli import main

sys.exit(main())

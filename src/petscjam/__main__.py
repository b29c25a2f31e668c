"""``python -m petscjam``: the command ``petscjam``."""

import sys

from petscjam.cli import main

if __name__ == "__main__":
    sys.exit(main())

"""``python -m identification`` is ``needleforce identify``."""

import sys

from needleforce.cli import main

if __name__ == "__main__":
    sys.exit(main(["identify", *sys.argv[1:]]))

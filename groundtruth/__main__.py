"""``python -m groundtruth`` is ``needleforce simulate``."""

import sys

from needleforce.cli import main

if __name__ == "__main__":
    sys.exit(main(["simulate", *sys.argv[1:]]))

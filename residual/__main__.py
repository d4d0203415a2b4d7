"""``python -m residual`` is ``needleforce force``."""

import sys

from needleforce.cli import main

if __name__ == "__main__":
    sys.exit(main(["force", *sys.argv[1:]]))

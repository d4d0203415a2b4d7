"""``python -m needleforce``."""

import sys

from needleforce.cli import main

if __name__ == "__main__":
    sys.exit(main())

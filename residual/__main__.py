"""``python -m residual``: forwards to `needleforce.cli.force`."""

import sys

from needleforce.cli.force import main

if __name__ == "__main__":
    sys.exit(main())

"""``python -m identification``: forwards to `needleforce.cli.identify`."""

import sys

from needleforce.cli.identify import main

if __name__ == "__main__":
    sys.exit(main())

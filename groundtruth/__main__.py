"""``python -m groundtruth``: forwards to `needleforce.cli.simulate`."""

import sys

from needleforce.cli.simulate import main

if __name__ == "__main__":
    sys.exit(main())

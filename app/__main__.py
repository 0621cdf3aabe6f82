"""``python3 -m mantle`` is the command ``mantle``."""

import sys

from mantle.cli import main

if __name__ == "__main__":
    sys.exit(main())

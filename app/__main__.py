"""``python3 -m app`` is the command ``mantle``."""

import sys

from app.cli import main

if __name__ == "__main__":
    sys.exit(main())

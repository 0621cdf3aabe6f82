"""The program behind `mantle.py` and the command line; README.md beside this file is its map."""

import os

# Switch off pydantic's search for plugins and its check of schemas at import.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
os.environ.setdefault("PYDANTIC_SKIP_VALIDATING_CORE_SCHEMAS", "1")

"""The program behind `mantle.py` and the command line; README.md beside this file is its map."""

import os

# What pydantic does at import beside its work: look for plugins, and check the schemas it has made.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
os.environ.setdefault("PYDANTIC_SKIP_VALIDATING_CORE_SCHEMAS", "1")

"""mantle: the application. Everything between the command line and the solver."""

import os

__version__ = "0.1.0"

# What pydantic does at import beside its work: look for plugins, and check the schemas it has made.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
os.environ.setdefault("PYDANTIC_SKIP_VALIDATING_CORE_SCHEMAS", "1")

"""The packages that add to the core; importing this module registers them.

Without the name and the folder of a package, the core runs every case that has none of its keys.
"""

# Importing a package registers it.
from app import bearing, fatigue, patient, press_fit, remodelling  # noqa: F401

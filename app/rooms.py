"""The packages that add to the core, one line each; importing this module registers them.

Without its line, and without its folder, the core runs every case that has none of its keys.
"""

from app import fatigue, remodelling

ROOMS = (fatigue, remodelling)

"""The program behind `mantle.py` and the command line; README.md beside this file is its map."""

__version__ = "0.1.0"

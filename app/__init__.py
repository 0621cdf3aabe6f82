"""The program behind `mantle.py` and the command line; README.md beside this file is its map."""

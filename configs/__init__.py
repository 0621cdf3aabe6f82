"""Shipped cases: files to run, to copy and to vary."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent

"""The case: its parts, its bases and libraries, checks between parts, many runs of one case."""

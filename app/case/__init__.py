"""The case: its parts, what it is laid over, checks of one part against another, many from one."""

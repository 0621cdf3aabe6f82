"""Numbers, fields, errors and files of a run.

It imports everything from `stepping` down. Begin with `interface_numbers` and `run_folder`.
"""

"""The command line: its grammar, and what each command does.

It imports all packages and the public functions of `mantle`. Begin with `commands`.
"""

"""The command line: its grammar and its commands.

It imports all packages and the public functions of `mantle`. Begin with `commands`.
"""

"""Pages, figures and tables of finished runs.

It imports everything from `campaigns` down; `verification` and it do not know each other. Begin
with `sweep_report`.
"""

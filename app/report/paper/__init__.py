"""The paper by Rakotomanana and Ramaniraka: its cases, figures, numbers and claims.

Only `mantle.report` imports it. Begin with `cases`.
"""

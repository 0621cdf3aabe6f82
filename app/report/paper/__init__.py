"""The paper by Rakotomanana and Ramaniraka: its cases, figures, numbers and claims.

Only `app.report` imports it. Begin with `cases`.
"""

"""The tables of a run, for the terminal and for the page.

Reading order: `run_tables` (all of them, in order), `summary` (several runs in one cell),
`force_table`; the others are alike. `screen` is where they go.
"""

"""The page that holds a whole run: counterparts of the paper's figures, tables, all numbers.

Reading order: `report_page` (puts the page together from what all runs gave), `sections`,
`page_tables`; `gel_friction` with `friction_chart` and `gel_table`, which need several runs.
"""

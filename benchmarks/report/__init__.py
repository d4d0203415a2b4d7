"""The report of a run: counterparts of the paper's figures, tables, and one page that holds all.

Reading order: `paper_figures` says which scenario gives which figure; `run_drawings` draws one run
in its own process; `report_page` puts the page together from what all runs gave.
"""

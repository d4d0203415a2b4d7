"""Tables, figures and the page of a run.

Reading order: `frames` and `tables` (groups of rows), `summary` (in documents),
`published_figures` (what there is to compare), `force_plots`, `identification_figures`
and `identification_plots` (the figures), `page` (all in one file).
"""

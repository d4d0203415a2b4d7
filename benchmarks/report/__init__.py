"""Tables, figures and the page of a run.

Reading order: `tables` (groups of rows), `figures` (tables of documents),
`published_figures` (what there is to compare), `force_plots` and
`identification_figures` (the figures), `page` (all in one file).
"""

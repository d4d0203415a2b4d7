"""Charts of one run, drawn in the process that ran it.

A ``*_chart`` says what is in a chart, the ``*_drawings`` beside it which of them are drawn for a
run, and with which words.

Reading order: `paper_figures` (which scenario gives the counterpart of which figure),
`run_drawings` (every chart of a run), `sketchbook` (where they are drawn), `force_drawings` with
`force_chart`; the others are alike.
"""

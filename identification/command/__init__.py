"""The command ``python -m identification LOG``: a recording in, layers and online estimates out.

Reading order: `arguments`, `run_log` (the log through the identifier), `estimate_table`,
`layer_table`, `figure` and `report` (what comes out). These modules, and no others of
`identification`, know files.
"""

"""The command ``python -m residual LOG``: a recording in, forces with standard deviations out.

Reading order: `arguments`, `run_log` (rows in, forces out), `replay` (the sensor), `force_table`,
`force_chart` and `force_report` (what comes out). These modules, and no others of `residual`, know
files.
"""

"""The command ``python -m residual LOG``: a recording in, forces with standard deviations out.

Reading order: `arguments`, `joint_signals` (the log), `replay` (the sensor over it), `force_table`,
`force_chart` and `force_report` (what comes out). These modules, and no others of `residual`, know
files.
"""

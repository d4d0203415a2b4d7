"""CSV and its kin, plain or compressed with gzip, in and out.

Reading order: `format` (reading, whole or as it comes), `header`, `rows`, `columns` (fast), `cells`
and `line` (slower, for what is broken), `exact_stamps`, `writer`.
"""

"""Named columns of numbers, before anyone has said what they mean.

Reading order: `table` (read), `labels` (what numbers do not say), `checked_columns` (to be
written), `flat_columns`, `joined_tables`.
"""

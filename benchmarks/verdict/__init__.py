"""What the numbers should be, and whether they are.

Reading order: `targets` and `identification_targets` with `scenario_groups`, `target_verdict`
(met or missed); `published` (what the paper measured); `comparison` (what has become worse since
an earlier run).
"""

"""How good an estimate is: what each number means, and how it is measured.

Reading order: `metric_catalogue` and `identification_catalogue` (every metric there is),
`measurement`; `wrench_metrics` (the axial force) with `force_lag`, `residual_metrics`;
`identification_metrics`, which calls for `transition` (which alarm belongs to which rupture),
`rupture_metrics`, `friction_metrics`, `enhanced_metrics`, `table_one` and `bound_metrics`.
"""

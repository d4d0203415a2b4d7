"""One insertion: force and identification against ground truth.

Reading order: `signals` (what estimators get, and the ground truth), `methods`
(estimators on a signal, errors of a force), `ruptures`, `offline` and `metrics` (how
good they are), put together in `simulated`, `robustness` (in the worlds of
`perturbations`), `ablation` and `recorded`.
"""

"""One insertion: force and identification against ground truth.

Reading order: `signals` (what estimators get, and the ground truth), `methods`
(estimators on a signal, errors of a force), `ruptures`, `offline`, `metrics` and
`bounds` (how good they are, how good they could be), put together in `simulated`,
`robustness` (in the worlds of `perturbations`) and `recorded`.
"""

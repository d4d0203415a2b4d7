"""The bias of the residual: what it reads without contact, and how it is removed.

Reading order: `model` (its causes, with a prior on each), `joint_states` (hysteresis
and friction), `fit` (from free motion), `tare_check` (which motion is refused),
`estimator` (all of it, tick by tick, and where the bias is kept). The identification
has a zero of its own: see docs/explanation/zeros.md.
"""

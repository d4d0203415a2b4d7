"""What estimators get, and the truth they are judged against.

Reading order: `joint_signals` (all that the virtual sensor gets), `needle_signal` (all that an
identifier gets) with `measured_travel`; `force_truth` and `insertion_truth`, which only metrics
and charts see.
"""

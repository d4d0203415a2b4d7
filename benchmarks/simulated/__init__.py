"""Benchmarks on simulated insertions, with an arm or with the needle alone.

Reading order: `simulated_job` (a job from its name to its numbers), `arm_case` (one insertion and
the sensors that watch it), `arm_identification`, `needle_benchmark`; `observers` is a benchmark of
its own.
"""

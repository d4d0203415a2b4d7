"""The verdict: estimators against truth, on simulated insertions and on real recordings.

``python -m benchmarks`` has a file for each of its commands: `run_command`, `speed_command` and so
on. Reading order: `catalogue` (what can be run), `simulated` (one insertion, the sensors that watch
it, the metrics), `metric_catalogue` (what the numbers mean), `targets` (what they should be),
`verdict` (whether they are).

Not part of the installed packages: run it from the repository.
"""

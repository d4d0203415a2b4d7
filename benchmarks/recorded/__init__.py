"""Benchmarks on recordings of real arms and of real tissue.

A file named after what was recorded reads it (`panda`, `ur10e`, `liver`, `bovine`), with
`array_files`; a file named after a benchmark runs it.

Reading order: `panda`, `panda_real`, `ur10e_payload` (real arms); `liver`, `pullout` (the
yardstick), `liver_told`, `liver_real` (real tissue); `panda_liver` (both together); `bovine_real`;
`liver_limit` with `regression` (what such recordings can tell at all).
"""

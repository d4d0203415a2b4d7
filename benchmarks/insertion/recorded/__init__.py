"""Benchmarks on recordings of real arms and of real tissue.

Reading order: `panda` and `ur10e` (real arms), `liver` and `bovine` (real tissue;
`liver` also reads files for the others).
"""

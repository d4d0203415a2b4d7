"""The commands of ``python -m benchmarks``, a file for each, named as the command is.

Reading order: `arguments` (what can be asked for), `dispatch` (who does it, and what becomes of
errors), `run` (benchmarks to tables and files); then `list`, `compare`, `bound`, `speed`, `faults`
and `stream`.
"""

"""The verdict: estimators against truth, on simulated insertions and on real recordings.

Here lies what is run: the `catalogue` of benchmarks, their way from a `plan` to jobs on several
processes, and the rows that come back. Everything else is in folders.

Reading order: `catalogue` (what can be run), `benchmark` and `job` (one thing to run, one piece of
work), `row` (a number that comes of it). Then the folders, in the order in which numbers come
about: `signals` (what estimators get, and the truth), `methods` (estimators on a signal),
`metrics` (how good they are) and `bounds` (how good they could be), put together in `simulated`
and `recorded` (the benchmarks); `verdict` (what the numbers should be, whether they are), `tables`,
`charts` and `report` (how they are shown). Apart from these: `speed` (what a tick costs) and
`faults` (what broken signals do). Each command has a file in `commands`.

Not part of the installed packages: run it from the repository, ``python -m benchmarks --help``.
"""

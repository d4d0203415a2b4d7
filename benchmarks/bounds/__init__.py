"""What the noise of a force allows any estimator to know; the words are in docs/limits.md.

Reading order: `noise_colour` (the noise as a process), `friction_bound` (Cramér-Rao),
`delay_bound` (Lorden), `bound_cases` (how they change with tissue and speed).
"""

"""Commands on recordings: a log read, run through the estimators, shown.

Reading order: `columns` (which columns are which channels), `forces`, `layers`,
`plan_found` (the three results), `result` (as text, JSON, page), `figures`,
`replay` (a command from its options to its output), `simulated_log`, `session_view`
(a session over a recording, in the scene).
"""

"""Commands on recordings: a log read, run through the estimators, shown.

Reading order: `log_session` (columns and rows), `replay_setup` (options to a
`needleforce.sensor_replay`), `force_result`, `force_page`, `force_run`, `layer_result`,
`layer_page`, `identify_run`, `row_overview`, `outputs` (files), `simulated_log`,
`session_view` (a session over a recording, in the scene).
"""

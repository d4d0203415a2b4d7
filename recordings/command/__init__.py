"""What the commands share: options, the log that is read, how they end.

Reading order: `run_command` (errors, exit codes), `source_arguments`, `mapping_arguments` and
`output_arguments`, `log_session` (a command reads its log), `stop_request` (Ctrl-C), `progress`,
`row_overview` (few rows for a picture), `suggest_mapping` (`--print-config`).
"""

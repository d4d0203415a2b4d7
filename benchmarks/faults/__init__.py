"""What broken signals do to a running insertion.

Reading order: `injection` (how signals break), `study` (what becomes of the estimates),
`false_alarms` (valid samples that the checks reject).
"""

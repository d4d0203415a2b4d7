"""What the estimators cost: time and memory of a tick, and of a long recording.

Reading order: `timing` (several subjects side by side), `tick_speed` with `chain_tick` (a tick,
beside the bare Pinocchio calls), `rerun_speed`, `gc_pauses`, `soak` (a million ticks),
`speed_table`. Of the commands on a long recording: `long_recording`, `watched_process`,
`stream_speed`.
"""

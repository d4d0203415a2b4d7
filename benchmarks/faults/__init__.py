"""Faults injected into a running insertion: what the chain makes of them, what it tells.

Reading order: `fault` (a fault and what came of it), `signal_faults`, `motion_faults`,
`pose_faults`, `tare_fault`; all of them in `fault_study`.
"""

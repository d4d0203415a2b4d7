"""Commands on an arm that sends its joint signals: they are recorded or watched.

Reading order: `arm_connection` (and a recording), `arm_watch` (a session beside the
arm), `arm_lag` (the delay of its motion).
"""

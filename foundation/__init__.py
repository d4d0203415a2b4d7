"""What every package stands on: array types, the compiler, checked states.

Nothing here knows a robot or a needle, and nothing of ours is imported here.

Reading order: `arrays`, `jit`, `records`, `linear_algebra`, `state`, `errors`.
"""

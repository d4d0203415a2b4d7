"""Which columns of a table are which channels of a log, and in which unit they stand.

Reading order: `channel` (what a log may hold), `units`, `name` and `detect` (columns with usual
names), `spec`, `mapping` and `find` (columns that a user names), `mapping_file`, `wanted` (what a
command asks for), `si_channel` (columns become numbers in SI units); `unit_hints` and
`finite_watch` look at those.
"""

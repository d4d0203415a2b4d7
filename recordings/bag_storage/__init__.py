"""The files of a ROS 2 bag, MCAP or SQLite, down to serialised messages; broken ones too.

Reading order: `files` (which make a bag), `raw_message`, `messages` (in the order in which they
were recorded); `mcap_messages`, `mcap_records`, `mcap_compression`; `sqlite_messages`,
`sqlite_salvage`.
"""

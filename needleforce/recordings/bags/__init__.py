"""ROS 2 bags: their messages as columns of numbers, and rows as messages.

A bag is an MCAP file, an SQLite file, or a folder of them. It is read from its start,
as far as it goes: a recorder that was killed leaves no index, and one that still writes
has none yet.

Reading order: `messages` (topics and messages as bytes), `mcap_file`, `sqlite_file`,
`message_reader` (of any bag), `message_types` (bytes to numbers), `topics` (what a bag
holds), `joined_rows` (topics interpolated to one of them), `tables`. Writing:
`written_topics`.
"""

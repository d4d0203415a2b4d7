"""ROS bags: their messages as columns of numbers, and rows as messages.

A bag of ROS 2 is an MCAP file or an SQLite file, one of ROS 1 a `.bag` file; a folder
of such files is one, too. It is read from its start, as far as it goes: a recorder that
was killed leaves no index, and one that still writes has none yet.

Reading order: `messages` (topics and messages as bytes), `mcap_file`, `ros1_file`,
`message_reader` (of any bag), `message_types` (bytes to numbers), `topics` (what a bag
holds), `tables` (topics interpolated to one of them). Writing: `written_topics`.
"""

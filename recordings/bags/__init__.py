"""ROS 2 bags as tables, in and out: topics are columns, messages are rows.

Reading order: `format`, `survey` (what a bag holds), `plan` (which topics are read, whose messages
are the rows), `tables`; one topic: `message_types`, `cdr_layout`, `message_columns`,
`topic_reader`, `interpolate`. A bag that is still recorded: `growing`. Writing: `writer`, `layout`,
`topic_encoder`, `events`, `folder`.
"""

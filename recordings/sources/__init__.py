"""Bytes as they come: from a file, from a pipe, from a file that still grows.

Reading order: `byte_source`, `growing_file`, `piped_binary` (a format that must be complete),
`unpacked`, `text_lines`.
"""

"""npz and Parquet: files that hold one column after the other.

Reading order: `npz_format`, `npz_member`, `npz_writer`; `parquet_format`, `parquet_column`,
`parquet_writer`.
"""

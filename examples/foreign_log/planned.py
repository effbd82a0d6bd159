"""A planned path as a motion planner may write it: degrees, and only the drives' positions.

    deltaid demo --keep demo
    python planned.py

writes planned.csv from the second recording of `deltaid demo`.
"""

import polars as pl

rows = pl.read_csv("demo/verify.csv")
rows.select("t", *(pl.col(f"q{i}").degrees() for i in (1, 2, 3, 4))).write_csv("planned.csv")

"""Asks a catalogue what docs/howto/catalogue.md asks, in DuckDB, and compares the answers; reads it in Polars, too.

Arguments: the catalogue's folder, the document. Each block of SQL is followed by a block with its answer, a row a line. Prints the number
of questions and of rows.
"""

import os
import re
import sys
from pathlib import Path

import duckdb
import polars

catalogue, document = sys.argv[1:]
text = Path(document).read_text()
os.chdir(Path(catalogue).parent)
assert Path(catalogue).name == "catalogue"
questions = re.findall(r"```sql\n(.*?)```\n+```text\n(.*?)```", text, re.DOTALL)
for question, stated in questions:
    answer = "".join(" | ".join(map(str, row)) + "\n" for row in duckdb.sql(question).fetchall())
    assert answer == stated, f"{question}\nanswers\n{answer}\nand the document states\n{stated}"

frames = polars.scan_parquet("catalogue/**/*.parquet", hive_partitioning=True).collect()
[(rows, valid)] = duckdb.sql("select count(*), count(*) filter (valid) from 'catalogue/**/*.parquet'").fetchall()
assert (frames.height, frames["valid"].sum()) == (rows, valid)
assert {"field", "date", "robot"} <= set(frames.columns)
assert frames.filter(polars.col("valid"))["x_m"].null_count() == 0
print(len(questions), rows)

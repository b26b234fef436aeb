"""Asks a catalogue what docs/howto/catalogue.md asks, in DuckDB, and compares the answers; reads it in Polars, too.

Arguments: the catalogue's folder, the document, and perhaps the program, which is then asked the same. Each block of SQL is followed by a
block with its answer, a row a line. Prints the number of questions and of rows.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import duckdb
import polars

catalogue, document, *programs = sys.argv[1:]
text = Path(document).read_text()
os.chdir(Path(catalogue).parent)
assert Path(catalogue).name == "catalogue"
questions = re.findall(r"```sql\n(.*?)```\n+```text\n(.*?)```", text, re.DOTALL)
duckdb.sql("create view frames as from 'catalogue/**/*.parquet'")
for question, stated in questions:
    asked = duckdb.sql(question)
    answer = "".join(" | ".join(map(str, row)) + "\n" for row in asked.fetchall())
    assert answer == stated, f"{question}\nanswers\n{answer}\nand the document states\n{stated}"
    for program in programs:
        lines = subprocess.check_output([program, "catalogue", "query", "catalogue", question, "--json"], text=True).splitlines()
        rows = [[json.loads(line).get(name) for name in asked.columns] for line in lines]
        said = "".join(" | ".join(map(str, row)) + "\n" for row in rows)
        assert said == stated, f"{question}\n{program} answers\n{said}\nand the document states\n{stated}"

frames = polars.scan_parquet("catalogue/**/*.parquet", hive_partitioning=True).collect()
[(rows, valid)] = duckdb.sql("select count(*), count(*) filter (valid) from 'catalogue/**/*.parquet'").fetchall()
assert (frames.height, frames["valid"].sum()) == (rows, valid)
assert {"field", "date", "robot"} <= set(frames.columns)
assert frames.filter(polars.col("valid"))["x_m"].null_count() == 0
print(len(questions), rows)

"""Times the documented queries of a catalogue in DuckDB: seconds (the better of two runs) and megabytes read.

    time_queries.py CATALOGUE docs/howto/catalogue.md
"""

import re
import sys
import time

import duckdb

folder, document = sys.argv[1:3]
queries = re.findall(r"```sql\n(.*?)```", open(document, encoding="utf-8").read(), re.DOTALL)
queries.append(
    "select count(*) from frames where valid and x_m between 1 and 1.5 and y_m between 0.5 and 1 and yaw_deg between 0 and 30"
)


def read_bytes():
    with open("/proc/self/io", encoding="ascii") as io:
        return int(io.readline().split()[1])


def asked(query):
    connection = duckdb.connect()
    connection.sql(f"create view frames as from read_parquet('{folder}/**/*.parquet', hive_partitioning=true)")
    before, began = read_bytes(), time.perf_counter()
    connection.sql(query).fetchall()
    return time.perf_counter() - began, read_bytes() - before


[(rows,)] = duckdb.sql(f"select count(*) from '{folder}/**/*.parquet'").fetchall()
print(f"{rows} rows")
for query in queries:
    seconds, megabytes = min(asked(query) for _ in range(2))
    print(f"{seconds:8.2f} s {megabytes / 1e6:8.0f} MB  {' '.join(query.split())[:90]}")

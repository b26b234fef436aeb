"""Does a job on a cluster of Ray with two nodes on this machine, takes one node away in the middle, and compares with a job without Ray.

Arguments: the folder of captures, a folder with the results of `--step tag` made without Ray, and a folder for those made with it.
"""

import sys
import threading
import time
from pathlib import Path

import ray
from ray.cluster_utils import Cluster

import realitysim.ray

captures, expected, results = map(Path, sys.argv[1:])
SHARDS = 8


def whole(folder: Path) -> "set[str]":
    return {path.name for path in folder.glob("tag/*") if not path.name.startswith(".")}


def take_a_node_away() -> None:
    while not whole(results):
        time.sleep(0.01)
    cluster.remove_node(node, allow_graceful=False)


cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
node = cluster.add_node(num_cpus=1)
ray.init(address=cluster.address, logging_level="ERROR")
killer = threading.Thread(target=take_a_node_away)
killer.start()
reports = realitysim.ray.job(captures, results, step="tag", shards=SHARDS)
killer.join()
ray.shutdown()
cluster.shutdown()

assert [report["shard"] for report in reports] == [f"{number}/{SHARDS}" for number in range(1, SHARDS + 1)]
units = [unit for report in reports for unit in report["units"]]
assert all(unit["state"] != "failed" for unit in units), units
assert sorted(unit["session"] for unit in units) == sorted(path.name for path in captures.iterdir() if path.is_dir())
assert whole(results) == whole(expected)
for name in whole(expected):
    for path in (expected / "tag" / name).iterdir():
        assert (results / "tag" / name / path.name).read_bytes() == path.read_bytes(), path
print(len(units), "sessions")

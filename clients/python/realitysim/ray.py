"""A job over many captures as tasks of Ray (``pip install ray``): one task for each shard, on any cluster that Ray is connected to.

    import ray, realitysim.ray

    ray.init("auto")
    reports = realitysim.ray.job("/captures", "/results", step="refine", shards=16)

Each machine of the cluster needs this package and sees the two folders under the same names.
"""

from __future__ import annotations

import json
import os
import subprocess
from typing import Any, Dict, List, Sequence, Union

import ray  # type: ignore[import-not-found, import-untyped, unused-ignore]

from .errors import ProgramError
from .service import program

__all__ = ["job"]

# Exit codes of a job whose report says all: done, some sessions failed, data was lost.
_TOLD = (0, 1, 3)


def job(
    captures: Union[str, "os.PathLike[str]"],
    results: Union[str, "os.PathLike[str]"],
    step: str,
    shards: int,
    cpus: int = 1,
    arguments: Sequence[str] = (),
) -> List[Dict[str, Any]]:
    """Does ``realitysim job`` in ``shards`` tasks of ``cpus`` processors each, and returns the report of each.

    A task whose machine dies is started again by Ray, and does what is left of its shard: results that are whole are not made again. A
    session that failed is in its shard's report; a call that is wrong is a ``ProgramError``. ``arguments`` are further ones of the program.
    """
    call = ["job", os.path.abspath(captures), "--step", step, "--workers", str(cpus), "-o", os.path.abspath(results), "--json", *arguments]
    task = ray.remote(num_cpus=cpus, max_retries=-1)(_shard)
    waiting = [task.remote([*call, "--shard", f"{number}/{shards}"]) for number in range(1, shards + 1)]
    reports: List[Dict[str, Any]] = ray.get(waiting)
    return reports


def _shard(call: List[str]) -> Dict[str, Any]:
    done = subprocess.run([program(), *call], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode not in _TOLD or not done.stdout:
        raise ProgramError(done.stderr.strip() or f"realitysim job ended with {done.returncode}")
    report: Dict[str, Any] = json.loads(done.stdout)
    return report

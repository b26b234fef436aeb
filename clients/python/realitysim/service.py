"""The service as a process of one's own: views and captures without a server that somebody starts."""

from __future__ import annotations

import json
import os
import pathlib
import secrets
import shutil
import subprocess
import sysconfig
import tempfile
import weakref
from typing import IO, List, Optional, Union

from .client import Client
from .errors import ProgramError

__all__ = ["serve"]

Folder = Union[str, "os.PathLike[str]"]


def serve(db: Optional[Folder] = None, captures: Optional[Folder] = None, lenses: Optional[List[str]] = None) -> Client:
    """Starts ``realitysim serve`` on a database, a folder of captures, or both, and returns a client of it.

    The service listens on a free port of this machine, for this client alone, and ends when the client is closed or forgotten.
    ``lenses`` are given as for ``--lens``: ``["NAME=FILE"]``.
    """
    token = secrets.token_urlsafe(32)
    options = [argument for lens in lenses or [] for argument in ("--lens", lens)]
    options += [f"--db={os.fspath(db)}"] if db is not None else []
    options += [f"--captures={os.fspath(captures)}"] if captures is not None else []
    with tempfile.NamedTemporaryFile("w", prefix="realitysim-token-") as file, tempfile.TemporaryFile() as errors:
        file.write(token)
        file.flush()
        command = [program(), "serve", "--json", "--listen", "127.0.0.1:0", "--token-file", file.name, *options]
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors)
        address = _address(child, errors)
    return _OwnedServiceClient(f"http://{address}", token, child)


def program() -> str:
    """The program that was installed with this package, else that of the path."""
    beside = pathlib.Path(sysconfig.get_path("scripts")) / "realitysim"
    found = str(beside) if beside.is_file() else shutil.which("realitysim")
    if found is None:
        raise ProgramError("the program realitysim is not on the path: `pip install realitysim`, or install its Debian package")
    return found


class _OwnedServiceClient(Client):
    """The client of a service that ends with it."""

    def __init__(self, url: str, token: str, child: "subprocess.Popen[bytes]"):
        super().__init__(url, token)
        self._end = weakref.finalize(self, _end, child)

    def close(self) -> None:
        super().close()
        self._end()


def _address(child: "subprocess.Popen[bytes]", errors: IO[bytes]) -> str:
    """Where the service listens. It says so, or ends with an error."""
    assert child.stdout is not None
    line = child.stdout.readline()
    try:
        return str(json.loads(line)["listening"])
    except (ValueError, KeyError, TypeError):
        _end(child)
        errors.seek(0)
        said = errors.read().decode("utf-8", "replace").strip()
        raise ProgramError(said or f"realitysim serve ended with exit code {child.returncode}") from None


def _end(child: "subprocess.Popen[bytes]") -> None:
    child.terminate()
    try:
        child.wait(10)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    if child.stdout is not None:
        child.stdout.close()

"""The client for programs that run in an event loop."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import Any, AsyncIterator, Callable, Dict, Iterable, List, Mapping, Optional, TypeVar, Union

import numpy as np

from .client import Client
from .errors import ServiceError
from .view import View

__all__ = ["AsyncClient"]

T = TypeVar("T")


class AsyncClient:
    """As ``Client``, with coroutines: up to ``connections`` requests at once, each over its own connection in a thread.

    It is made inside of the loop that uses it.
    """

    def __init__(
        self,
        url: str = "http://127.0.0.1:8765",
        token: Optional[str] = None,
        timeout_s: float = 30.0,
        patience_s: float = 30.0,
        connections: int = 4,
    ):
        self._make: Callable[[], Client] = lambda: Client(url, token, timeout_s, patience_s)
        self._idle = [self._make() for _ in range(connections)]
        self._room = asyncio.Semaphore(connections)

    async def view(
        self, x: float, y: float, z: float, yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0, **parameters: Any
    ) -> View:
        """The view from a pose: ``Client.view``."""
        return await self._with(lambda client: client.view(x, y, z, yaw_deg, pitch_deg, roll_deg, **parameters))

    async def view_of_matrix(self, map_from_camera: Any, z_forward: bool = False, **parameters: Any) -> View:
        """The view of a matrix: ``Client.view_of_matrix``."""
        return await self._with(lambda client: client.view_of_matrix(map_from_camera, z_forward, **parameters))

    async def views(self, poses: Iterable[Mapping[str, Any]], **parameters: Any) -> AsyncIterator[Union[View, ServiceError]]:
        """Many views with one request, as they are made: ``Client.views``."""
        async with self._client() as client:
            parts = await _in_thread(client, lambda: client.views(poses, **parameters))
            while (view := await _in_thread(client, lambda: next(parts, None))) is not None:
                yield view

    async def info(self) -> Dict[str, Any]:
        """What the database holds: ``Client.info``."""
        return await self._with(Client.info)

    async def coverage(self, cell_m: float = 0.25, headings: int = 24) -> np.ndarray:
        """How many images there are: ``Client.coverage``."""
        return await self._with(lambda client: client.coverage(cell_m, headings))

    async def captures(self) -> List[Dict[str, Any]]:
        """The captures that the service shows: ``Client.captures``."""
        return await self._with(Client.captures)

    def close(self) -> None:
        for client in self._idle:
            client.close()

    async def __aenter__(self) -> "AsyncClient":
        return self

    async def __aexit__(self, *_: Any) -> None:
        self.close()

    async def _with(self, work: Callable[[Client], T]) -> T:
        async with self._client() as client:
            return await _in_thread(client, lambda: work(client))

    @contextlib.asynccontextmanager
    async def _client(self) -> AsyncIterator[Client]:
        """A client that nobody else uses."""
        async with self._room:
            client = self._idle.pop()
            try:
                yield client
            except asyncio.CancelledError:
                # The thread of a task that is cancelled still waits for its answer: another connection takes its place.
                client = self._make()
                raise
            finally:
                self._idle.append(client)


async def _in_thread(client: Client, work: Callable[[], T]) -> T:
    """What the work gives; if nobody waits for it any more, the client is closed after it."""
    abandoned, at_work = threading.Event(), threading.Event()

    def run() -> T:
        at_work.set()
        try:
            return work()
        finally:
            at_work.clear()
            if abandoned.is_set():
                client.close()

    try:
        return await asyncio.to_thread(run)
    except asyncio.CancelledError:
        abandoned.set()
        if not at_work.is_set():
            client.close()
        raise

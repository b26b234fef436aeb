"""The client of a running service."""

from __future__ import annotations

import http.client
import json
import time
import urllib.parse
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Tuple, Union

import numpy as np

from .errors import Busy, ServiceError, ServiceTimeout, Unreachable, error_of
from .pose import pose_of_camera
from .view import View, view_of

__all__ = ["Client"]

# Pictures as bytes, and layers as an .npz, which is a ZIP archive.
_ACCEPTED = "application/octet-stream, application/zip"
_MAX_RETRY_S = 60.0


class Client:
    """One connection to a running ``realitysim serve``.

    A service that is busy (503) is asked again after the time that it names, for up to ``patience_s``; with 0 it is asked once.
    Errors are those of ``realitysim.errors``.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8765", token: Optional[str] = None, timeout_s: float = 30.0, patience_s: float = 30.0
    ):
        parts = urllib.parse.urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(f"{url!r}: http://HOST:PORT is needed")
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        self.url = url
        self.token = token
        self.timeout_s = timeout_s
        self.patience_s = patience_s
        self._connection = kind(parts.hostname, parts.port, timeout=timeout_s)
        self._response: Optional[http.client.HTTPResponse] = None

    def view(
        self, x: float, y: float, z: float, yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0, **parameters: Any
    ) -> View:
        """The view from a pose. ``parameters`` are those of /v1/view: method, width, height, lens, scene, figures, frame,
        max_distance_m, outside, mask, layers. The mask comes along (``view.mask``) unless ``mask="none"``; with
        ``layers="image,depth,mask,labels"`` the view has what is named there and nothing else."""
        pose = {"x": x, "y": y, "z": z, "yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
        return view_of(*self.get("/v1/view", {**pose, "mask": "alpha", **parameters}))

    def view_of_matrix(self, map_from_camera: Any, z_forward: bool = False, **parameters: Any) -> View:
        """The view of a 4 x 4 (or 3 x 4) matrix: axes x forward, y left, z up; with ``z_forward`` those of an optical
        frame, x right, y down, z forward."""
        return self.view(**pose_of_camera(map_from_camera, z_forward), **parameters)

    def views(self, poses: Iterable[Mapping[str, Any]], **parameters: Any) -> Iterator[Union[View, ServiceError]]:
        """Many views with one request, as they are made and in their order; an error stands in the place of a view that could
        not be made. The next request ends it."""
        return self._batch({"poses": [dict(pose) for pose in poses], "mask": "alpha", **parameters})

    def trajectory(
        self, start: Mapping[str, Any], end: Mapping[str, Any], count: int, **parameters: Any
    ) -> Iterator[Union[View, ServiceError]]:
        """``count`` views evenly from one pose to another, both included."""
        return self._batch({"from": dict(start), "to": dict(end), "count": count, "mask": "alpha", **parameters})

    def info(self) -> Dict[str, Any]:
        """What the database holds, which lenses and scenes there are."""
        found: Dict[str, Any] = json.loads(self.get("/v1/info")[1])
        return found

    def coverage(self, cell_m: float = 0.25, headings: int = 24) -> np.ndarray:
        """How many images there are: rows (y) x columns (x) x headings, from the carpet's corner at the least x and y."""
        found = json.loads(self.get("/v1/coverage", {"cell_m": cell_m, "headings": headings})[1])
        return np.array(found["counts"], dtype=np.uint32).reshape(found["rows"], found["columns"], found["sectors"])

    def captures(self) -> List[Dict[str, Any]]:
        """The captures that the service shows, the newest first: name, robot, started, frames, valid and more."""
        found: List[Dict[str, Any]] = json.loads(self.get("/v1/captures")[1])["sessions"]
        return found

    def close(self) -> None:
        self._connection.close()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def get(self, path: str, parameters: Optional[Mapping[str, Any]] = None) -> Tuple[Dict[str, str], bytes]:
        """Headers (names in small letters) and body of the answer to a GET request."""
        query = f"?{urllib.parse.urlencode(parameters)}" if parameters else ""
        response = self._patiently("GET", path + query, None)
        try:
            content = response.read()
        except (OSError, http.client.HTTPException) as error:
            raise self._broken(error) from error
        return {name.lower(): value for name, value in response.getheaders()}, content

    def _patiently(self, method: str, path: str, body: Optional[bytes]) -> http.client.HTTPResponse:
        """The first answer that is not a refusal for being busy; any other refusal is raised."""
        until = time.monotonic() + self.patience_s
        while True:
            response = self._send(method, path, body)
            if response.status == 200:
                return response
            try:
                error = error_of(response.status, response.read())
            except (OSError, http.client.HTTPException) as broken:
                raise self._broken(broken) from broken
            wait_s = _retry_after_s(response)
            if not isinstance(error, Busy) or time.monotonic() + wait_s > until:
                raise error
            time.sleep(wait_s)

    def _send(self, method: str, path: str, body: Optional[bytes]) -> http.client.HTTPResponse:
        headers = {"Accept": _ACCEPTED}
        if self.token is not None:
            headers["Authorization"] = f"Bearer {self.token}"
        if body is not None:
            headers["Content-Type"] = "application/json"
        # Nobody can tell the rest of an answer that was not read to its end from the next one.
        if self._response is not None and not self._response.isclosed():
            self._connection.close()
        for is_last in (False, True):
            try:
                self._connection.request(method, path, body, headers)
                self._response = self._connection.getresponse()
                return self._response
            except (http.client.RemoteDisconnected, BrokenPipeError, ConnectionResetError) as error:
                # The service hangs up on a connection that was idle; asking twice changes nothing.
                self._connection.close()
                if is_last:
                    raise self._broken(error) from error
            except (OSError, http.client.HTTPException) as error:
                raise self._broken(error) from error
            except BaseException:
                self._connection.close()
                raise
        raise AssertionError("unreachable")

    def _broken(self, error: Exception) -> Union[ServiceTimeout, Unreachable]:
        self._connection.close()
        if isinstance(error, TimeoutError):
            return ServiceTimeout(f"{self.url}: no answer within {self.timeout_s} s")
        return Unreachable(f"{self.url}: {error or type(error).__name__}")

    def _batch(self, request: Mapping[str, Any]) -> Iterator[Union[View, ServiceError]]:
        return self._parts(self._patiently("POST", "/v1/views", json.dumps(request, default=float).encode()))

    def _parts(self, response: http.client.HTTPResponse) -> Iterator[Union[View, ServiceError]]:
        boundary = b"--" + (response.getheader("Content-Type") or "").split("boundary=", 1)[-1].encode()
        try:
            while (line := response.readline().rstrip(b"\r\n")) == boundary:
                headers = {}
                for line in iter(response.readline, b"\r\n"):
                    if not line:
                        raise http.client.IncompleteRead(b"")
                    name, _, value = line.decode("latin-1").partition(":")
                    headers[name.lower()] = value.strip()
                body = response.read(int(headers["content-length"]))
                response.readline()
                status = int(headers["realitysim-status"])
                yield view_of(headers, body) if status == 200 else error_of(status, body)
            if line != boundary + b"--":
                raise http.client.IncompleteRead(line)
            response.read()
        except (OSError, http.client.HTTPException) as error:
            raise self._broken(error) from error


def _retry_after_s(response: http.client.HTTPResponse) -> float:
    """How long the service asks to wait; a second if it does not say, or says it as a date."""
    try:
        return min(_MAX_RETRY_S, max(0.0, float(response.getheader("Retry-After", "1"))))
    except ValueError:
        return 1.0

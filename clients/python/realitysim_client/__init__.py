"""Real camera images for any pose on the field, from a running ``realitysim serve``.

    from realitysim_client import Client
    client = Client("http://127.0.0.1:8765")
    view = client.view(x=0.3, y=-0.5, z=0.5, yaw_deg=30, pitch_deg=18)
    view.image        # numpy array, height x width x 3, uint8, R G B
    view.made         # stored, nearest, warped or composed
    view.mask         # height x width: 255 known geometry, 128 beyond the ground, 0 nothing; None with mask="none"
    client.view(..., layers="image,depth").depth    # height x width, float32: metres along the ray of each pixel

Poses are of ``camera_link`` in ``map``: x forward, y left, z up, metres; yaw, pitch, roll in degrees, pitch above 0 looks down.
A client holds one connection, so that a view costs no more than making it; use one for each thread.
"""

from __future__ import annotations

import http.client
import io
import json
import math
import urllib.parse
from dataclasses import dataclass, field
from typing import Any, Iterable, Iterator, Mapping, Optional, Sequence, Union

import numpy as np

__all__ = ["Client", "RealitySimError", "View", "pose_of_camera"]

# Pictures as bytes, and layers as an .npz, which is a ZIP archive.
_ACCEPTED = "application/octet-stream, application/zip"


class RealitySimError(Exception):
    """The service refused; ``status`` is HTTP's: 400 wrong request, 404 no image is near, 503 busy."""

    def __init__(self, status: int, detail: str):
        super().__init__(f"{status}: {detail}")
        self.status = status
        self.detail = detail


@dataclass
class View:
    """A picture and what it says of itself."""

    image: Optional[np.ndarray]
    """height x width x 3, uint8, R G B; height x width with mask="only"; None if ``layers`` leaves it out."""
    made: str
    """stored, nearest, warped or composed."""
    sources: list
    """Images it was made of: source, stamp_ns, distance_m, angle_deg, share."""
    valid_share: float
    sure_share: float
    expected_error_px: Optional[float]
    """Of known geometry; None where none is shown."""
    mask: Optional[np.ndarray] = None
    """height x width, uint8; None with mask="none" or mask="only", or if ``layers`` leaves it out."""
    depth: Optional[np.ndarray] = None
    """height x width, float32, with ``layers``: metres along the unit ray of each pixel, not along the optical axis. inf where
    the picture is far or its distance unknown, NaN where the lens draws nothing."""
    warning: Optional[str] = None
    """Set when the nearest image is farther away than allowed and outside="warn" was asked for."""
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)


class Client:
    """One connection to a running ``realitysim serve``."""

    def __init__(self, url: str = "http://127.0.0.1:8765", token: Optional[str] = None, timeout_s: float = 30.0):
        parts = urllib.parse.urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(f"{url!r}: http://HOST:PORT is needed")
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        self._connection = kind(parts.hostname, parts.port, timeout=timeout_s)
        self._response: Optional[http.client.HTTPResponse] = None
        self._headers = {"Accept": _ACCEPTED}
        if token is not None:
            self._headers["Authorization"] = f"Bearer {token}"

    def view(self, x: float, y: float, z: float, yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0, **parameters: Any) -> View:
        """The view from a pose. ``parameters`` are those of /v1/view: method, width, height, lens, scene, figures, frame,
        max_distance_m, outside, mask, layers. The mask comes along (``view.mask``) unless ``mask="none"``; with
        ``layers="image,depth,mask"`` the view has what is named there and nothing else."""
        pose = {"x": x, "y": y, "z": z, "yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
        query = urllib.parse.urlencode({**pose, "mask": "alpha", **parameters})
        headers, body = self._ask("GET", f"/v1/view?{query}")
        return _view(headers, body)

    def view_of_matrix(self, map_from_camera: Union[np.ndarray, Sequence], z_forward: bool = False, **parameters: Any) -> View:
        """The view of a 4 x 4 (or 3 x 4) matrix: axes x forward, y left, z up; with ``z_forward`` those of an optical
        frame, x right, y down, z forward."""
        return self.view(**pose_of_camera(map_from_camera, z_forward), **parameters)

    def views(self, poses: Iterable[Mapping[str, Any]], **parameters: Any) -> Iterator[Union[View, RealitySimError]]:
        """Many views with one request, as they are made and in their order; an error stands in the place of a view that could
        not be made. The next request ends it."""
        return self._batch({"poses": [dict(pose) for pose in poses], "mask": "alpha", **parameters})

    def trajectory(self, start: Mapping[str, Any], end: Mapping[str, Any], count: int, **parameters: Any) -> Iterator[Union[View, RealitySimError]]:
        """``count`` views evenly from one pose to another, both included."""
        return self._batch({"from": dict(start), "to": dict(end), "count": count, "mask": "alpha", **parameters})

    def info(self) -> dict:
        """What the database holds, which lenses and scenes there are."""
        return json.loads(self._ask("GET", "/v1/info")[1])

    def coverage(self, cell_m: float = 0.25, headings: int = 24) -> np.ndarray:
        """How many images there are: rows (y) x columns (x) x headings, from the carpet's corner at the least x and y."""
        query = urllib.parse.urlencode({"cell_m": cell_m, "headings": headings})
        found = json.loads(self._ask("GET", f"/v1/coverage?{query}")[1])
        return np.array(found["counts"], dtype=np.uint32).reshape(found["rows"], found["columns"], found["sectors"])

    def close(self) -> None:
        self._connection.close()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _ask(self, method: str, path: str, body: Optional[bytes] = None):
        response = self._send(method, path, body)
        content = response.read()
        if response.status != 200:
            raise _error(response.status, content)
        return _lower(response.getheaders()), content

    def _send(self, method: str, path: str, body: Optional[bytes]) -> http.client.HTTPResponse:
        headers = dict(self._headers)
        if body is not None:
            headers["Content-Type"] = "application/json"
        # Nobody can tell the rest of an answer that was not read to its end from the next one.
        if self._response is not None and not self._response.isclosed():
            self._connection.close()
        for again in (True, False):
            try:
                self._connection.request(method, path, body, headers)
                self._response = self._connection.getresponse()
                return self._response
            except (http.client.RemoteDisconnected, BrokenPipeError, ConnectionResetError):
                # The service hangs up on a connection that was idle; asking twice changes nothing.
                self._connection.close()
                if not again:
                    raise
            except BaseException:
                self._connection.close()
                raise
        raise AssertionError("unreachable")

    def _batch(self, request: Mapping[str, Any]) -> Iterator[Union[View, RealitySimError]]:
        response = self._send("POST", "/v1/views", json.dumps(request, default=float).encode())
        if response.status != 200:
            raise _error(response.status, response.read())
        return _parts(response)


def pose_of_camera(map_from_camera: Union[np.ndarray, Sequence], z_forward: bool = False) -> dict:
    """x, y, z, yaw_deg, pitch_deg, roll_deg of a 4 x 4 (or 3 x 4) matrix; axes as for ``Client.view_of_matrix``."""
    matrix = np.asarray(map_from_camera, dtype=float)
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise ValueError(f"a finite 4 x 4 or 3 x 4 matrix is needed, not one of {matrix.shape}")
    turn, place = matrix[:3, :3], matrix[:3, 3]
    if z_forward:
        # Columns: where the camera's own x (forward), y (left) and z (up) point.
        turn = np.stack([turn[:, 2], -turn[:, 0], -turn[:, 1]], axis=1)
    return {
        "x": float(place[0]),
        "y": float(place[1]),
        "z": float(place[2]),
        "yaw_deg": math.degrees(math.atan2(turn[1, 0], turn[0, 0])),
        "pitch_deg": math.degrees(math.asin(max(-1.0, min(1.0, -turn[2, 0])))),
        "roll_deg": math.degrees(math.atan2(turn[2, 1], turn[2, 2])),
    }


def _lower(headers: Iterable) -> dict:
    return {name.lower(): value for name, value in headers}


def _error(status: int, content: bytes) -> RealitySimError:
    try:
        return RealitySimError(status, str(json.loads(content)["detail"]))
    except (ValueError, KeyError, TypeError):
        return RealitySimError(status, content.decode("utf-8", "replace"))


def _view(headers: Mapping[str, str], body: bytes) -> View:
    error = headers.get("realitysim-expected-error-px")
    return View(
        **_layers(headers, body),
        made=headers["realitysim-made"],
        sources=json.loads(headers["realitysim-sources"]),
        valid_share=float(headers["realitysim-valid-share"]),
        sure_share=float(headers["realitysim-sure-share"]),
        expected_error_px=float(error) if error else None,
        warning=headers.get("realitysim-warning"),
        headers=headers,
    )


def _layers(headers: Mapping[str, str], body: bytes) -> dict:
    if headers["content-type"] == "application/zip":
        with np.load(io.BytesIO(body)) as arrays:
            return {name: arrays[name] if name in arrays else None for name in ("image", "depth", "mask")}
    width, height, channels = (int(headers[f"realitysim-{name}"]) for name in ("width", "height", "channels"))
    pixels = np.frombuffer(body, dtype=np.uint8).reshape(height, width, channels)
    return {
        "image": pixels[:, :, 0] if channels == 1 else pixels[:, :, :3],
        "mask": pixels[:, :, 3] if channels == 4 else None,
    }


def _parts(response: http.client.HTTPResponse) -> Iterator[Union[View, RealitySimError]]:
    boundary = b"--" + response.getheader("Content-Type").split("boundary=", 1)[1].encode()
    while response.readline().rstrip(b"\r\n") == boundary:
        headers = {}
        for line in iter(response.readline, b"\r\n"):
            name, _, value = line.decode("latin-1").partition(":")
            headers[name.lower()] = value.strip()
        body = response.read(int(headers["content-length"]))
        response.readline()
        status = int(headers["realitysim-status"])
        yield _view(headers, body) if status == 200 else _error(status, body)
    response.read()

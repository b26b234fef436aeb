"""Captures: recorded frames and their tags as arrays."""

from __future__ import annotations

import io
import json
import operator
import os
import pathlib
import warnings
from dataclasses import dataclass, field
from typing import Any, Dict, Iterator, List, Optional

import numpy as np

from .client import Client
from .errors import CaptureWarning, RealitySimError
from .lens import Lens
from .png import png
from .pose import matrix_of_pose
from .service import Folder, serve
from .view import pixels_of

__all__ = ["Capture", "Frame", "Tags", "open"]


def open(capture: Folder) -> "Capture":
    """Opens the folder of a capture, by the program of this machine: what is damaged is named, and the rest can be used."""
    folder = pathlib.Path(capture).resolve()
    if not (folder / "session.json").is_file():
        raise RealitySimError(f"{os.fspath(capture)}: this is no capture: it is a folder with a session.json, as `realitysim replay` writes it")
    client = serve(captures=folder.parent)
    try:
        return Capture(client, folder.name)
    except BaseException:
        client.close()
        raise


@dataclass(frozen=True)
class Tags:
    """The tags of a capture: one row for each tagged frame. Poses are of ``camera_link`` in ``map``."""

    stamp_ns: np.ndarray
    """n, int64: time of the exposure."""
    valid: np.ndarray
    """n, bool: whether the pose may be used."""
    ambiguous: np.ndarray
    """n, bool: whether the mirror pose, in the other half, explains everything as well."""
    reason: np.ndarray
    """n, text: why a tag is not valid; empty where it is."""
    has_image: np.ndarray
    """n, bool: whether the image was kept."""
    position: np.ndarray
    """n x 3, float64, metres."""
    orientation: np.ndarray
    """n x 4, float64, quaternion x y z w."""
    covariance: np.ndarray
    """n x 6 x 6, float64: x y z in metres, then rotations about these axes in radians."""
    map_from_camera: np.ndarray = field(repr=False)
    """n x 4 x 4, float64: the same poses as matrices; axes x forward, y left, z up."""

    def __len__(self) -> int:
        return len(self.stamp_ns)


@dataclass(frozen=True)
class Frame:
    """One frame of a capture."""

    capture: "Capture" = field(repr=False)
    index: int
    stamp_ns: int
    valid: bool
    reason: str
    map_from_camera: np.ndarray = field(repr=False)
    """4 x 4: pose of ``camera_link`` in ``map``; axes x forward, y left, z up."""

    @property
    def image(self) -> np.ndarray:
        """height x width x 3, uint8, R G B; ``NotFound`` if it was not kept."""
        headers, body = self.capture.ask("/v1/frame", frame=self.index)
        return pixels_of(headers, body)

    @property
    def tag(self) -> Dict[str, Any]:
        """Everything that the tag says, as the message FrameTag has it."""
        found: Dict[str, Any] = json.loads(self.capture.ask("/v1/tag", frame=self.index)[1])["tag"]
        return found

    def _repr_png_(self) -> Optional[bytes]:
        return png(self.image)


class Capture:
    """A capture that a service shows: a sequence of frames. ``realitysim.open`` opens one of this machine."""

    def __init__(self, client: Client, name: str):
        self.name = name
        self._client = client
        about = json.loads(self.ask("/v1/capture")[1])
        self.lens = Lens.of(about["lens"])
        """Intrinsic parameters of the camera."""
        self.robot: str = about["robot"]
        self.started: str = about["started"]
        self.field: Dict[str, Any] = about["field"]
        self.lost: List[str] = about["lost"]
        """What is lost or damaged; empty if the capture is whole."""
        if about["left_out"]:
            self.lost.append(f"{about['left_out']} frames beyond the {len(about['t_s'])} that are shown")
        if self.lost:
            warnings.warn(f"{name}: {'; '.join(self.lost)}", CaptureWarning, stacklevel=3)
        self.tags = self._tags(about["reasons"])

    def __len__(self) -> int:
        return len(self.tags)

    def __getitem__(self, index: int) -> Frame:
        count, wanted = len(self), operator.index(index)
        number = wanted + count if wanted < 0 else wanted
        if not 0 <= number < count:
            raise IndexError(f"there is no frame {wanted}: there are {count}")
        tags = self.tags
        valid, reason = bool(tags.valid[number]), str(tags.reason[number])
        return Frame(self, number, int(tags.stamp_ns[number]), valid, reason, tags.map_from_camera[number])

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    def close(self) -> None:
        self._client.close()

    def __enter__(self) -> "Capture":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def ask(self, path: str, **parameters: Any) -> Any:
        """Headers and body of what the service answers about this capture."""
        return self._client.get(path, {"capture": self.name, **parameters})

    def _tags(self, reasons: List[str]) -> Tags:
        with np.load(io.BytesIO(self.ask("/v1/tags")[1])) as arrays:
            found = {name: arrays[name] for name in arrays.files}
        flags = {name: found[name].astype(bool) for name in ("valid", "ambiguous", "has_image")}
        texts = np.array(reasons, dtype=str)[found["reason"]]
        poses = matrix_of_pose(found["position"], found["orientation"])
        return Tags(**{**found, **flags, "reason": texts}, map_from_camera=poses)

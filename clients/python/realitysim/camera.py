"""A camera in the form of a gymnasium environment."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np

from .client import Client
from .errors import NotFound
from .pose import pose_of_camera
from .view import View

__all__ = ["Camera"]

Observation = Dict[str, np.ndarray]
POSE = ("x", "y", "z", "yaw_deg", "pitch_deg", "roll_deg")


class Camera:
    """A camera that is moved over the field: ``reset``, ``step``, ``render`` and ``close`` as gymnasium's ``Env`` has them.

    An action is where the camera goes: six numbers (x, y, z in metres, yaw, pitch, roll in degrees), a mapping of these names, or
    ``map_from_camera`` as a 4 x 4 matrix (x forward, y left, z up). An observation has an array for each of ``layers``. The reward is
    0: an environment around this one knows what it is for. Where no image is near, the step is ``truncated``, the observation is the
    one before, and ``info["error"]`` says why.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
    render_mode = "rgb_array"

    def __init__(self, client: Client, start: Any, layers: str = "image", **parameters: Any):
        self._client = client
        self._start = start
        self._parameters = {"layers": layers, **parameters}
        self._view: Optional[View] = None
        if "image" not in layers.split(","):
            raise ValueError(f"layers is {layers!r}: image must be among them, for render()")

    def reset(self, *, seed: Optional[int] = None, options: Optional[Mapping[str, Any]] = None) -> Tuple[Observation, Dict[str, Any]]:
        """Puts the camera to ``options["pose"]``, or to where it started. Views hold no chance, so that ``seed`` changes nothing."""
        self._view = self._look((options or {}).get("pose", self._start))
        return self._observation(self._view), self._info(self._view)

    def step(self, action: Any) -> Tuple[Observation, float, bool, bool, Dict[str, Any]]:
        """Observation, reward, terminated, truncated and information."""
        if self._view is None:
            raise RuntimeError("call reset() first")
        try:
            self._view = self._look(action)
        except NotFound as error:
            return self._observation(self._view), 0.0, False, True, {"error": error.detail}
        return self._observation(self._view), 0.0, False, False, self._info(self._view)

    def render(self) -> np.ndarray:
        """The picture of the last step, height x width x 3, uint8."""
        if self._view is None or self._view.image is None:
            raise RuntimeError("call reset() first")
        return self._view.image

    def close(self) -> None:
        """Closes the client."""
        self._client.close()

    def _look(self, pose: Any) -> View:
        return self._client.view(**_pose(pose), **self._parameters)

    def _observation(self, view: View) -> Observation:
        names: List[str] = self._parameters["layers"].split(",")
        return {name: getattr(view, name) for name in names}

    @staticmethod
    def _info(view: View) -> Dict[str, Any]:
        shares = {"valid_share": view.valid_share, "sure_share": view.sure_share, "expected_error_px": view.expected_error_px}
        return {"made": view.made, "lens": view.lens, "sources": view.sources, **shares}


def _pose(action: Any) -> Dict[str, float]:
    if isinstance(action, Mapping):
        return {name: float(value) for name, value in action.items()}
    numbers = np.asarray(action, dtype=float)
    if numbers.shape == (len(POSE),):
        return {name: float(value) for name, value in zip(POSE, numbers)}
    return pose_of_camera(numbers)

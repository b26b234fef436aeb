"""The errors of a detector, sampled from what ``realitysim measure gap --error-model`` wrote."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from typing import Any, Dict, Iterable, List, Mapping, Optional, Tuple, Union

import numpy as np

__all__ = ["Detected", "ErrorModel"]


@dataclass(frozen=True)
class Detected:
    """What the detector says: a class such as ``x_crossing``, and where it is on the ground, seen from the camera; left is above 0."""

    name: str
    bearing_deg: float
    distance_m: float
    is_false: bool


class ErrorModel:
    """A model of a detector's errors."""

    def __init__(self, content: Mapping[str, Any]) -> None:
        if content.get("realitysim_error_model") != 1:
            raise ValueError("no error model of format 1, as `realitysim measure gap --error-model` writes it")
        self.classes: Dict[str, List[Dict[str, Any]]] = content["classes"]
        self.delay_ms: Dict[str, float] = content["delay_ms"]

    @classmethod
    def load(cls, path: Union[str, "os.PathLike[str]"]) -> "ErrorModel":
        with open(path, encoding="utf-8") as file:
            return cls(json.load(file))

    def cell(self, name: str, distance_m: float, off_axis_deg: float, speed_deg_s: Optional[float] = None) -> Optional[Dict[str, Any]]:
        """What is known of landmarks of this class there; None if none was ever to be seen so far away."""
        asked = {"distance_m": distance_m, "off_axis_deg": off_axis_deg, "speed_deg_s": speed_deg_s}
        fits = (cell for cell in self.classes.get(name, []) if all(_holds(cell[key], value) for key, value in asked.items()))
        return next(fits, None)

    def sample(
        self, random: np.random.Generator, landmarks: Iterable[Tuple[str, float, float]], *, x: float, y: float, z: float,
        yaw_deg: float, pitch_deg: float = 0.0, fov_deg: float = 90.0, speed_deg_s: Optional[float] = None,
    ) -> List[Detected]:
        """What the detector may say at a pose of ``camera_link`` in ``map``; landmarks are (class, x, y), seen within a cone of fov_deg."""
        yaw, pitch = math.radians(yaw_deg), math.radians(pitch_deg)
        axis = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)])
        found = []
        for name, at_x, at_y in landmarks:
            ray = np.array([at_x - x, at_y - y, -z])
            off_axis_deg = math.degrees(math.acos(np.clip(axis @ ray / np.linalg.norm(ray), -1.0, 1.0)))
            distance_m = math.hypot(ray[0], ray[1])
            cell = self.cell(name, distance_m, off_axis_deg, speed_deg_s) if 2.0 * off_axis_deg <= fov_deg else None
            if cell is not None and cell["ground"] is not None and random.random() < cell["detection_probability"]["value"]:
                ground = cell["ground"]
                bias = [ground["bearing_bias_deg"], ground["distance_bias_m"]]
                error = random.multivariate_normal(bias, ground["covariance"] or np.zeros((2, 2))).tolist()
                bearing_deg = math.degrees(math.atan2(ray[1], ray[0])) - yaw_deg + error[0]
                found.append(Detected(name, (bearing_deg + 180.0) % 360.0 - 180.0, max(0.0, distance_m + error[1]), False))
        return found + self._false_ones(random, fov_deg)

    def _false_ones(self, random: np.random.Generator, fov_deg: float) -> List[Detected]:
        found = []
        for name, cells in self.classes.items():
            for cell in (cell for cell in cells if cell["off_axis_deg"] is None and cell["speed_deg_s"] is None):
                low, high = cell["distance_m"]
                for _ in range(random.poisson(cell["false_per_picture"]["value"])):
                    distance_m = random.uniform(low, 1.5 * low if high is None else high)
                    found.append(Detected(name, random.uniform(-fov_deg / 2, fov_deg / 2), distance_m, True))
        return found


def _holds(band: Optional[List[Optional[float]]], value: Optional[float]) -> bool:
    if band is None or value is None:
        return band is None
    low, high = band
    return (low is None or low <= value) and (high is None or value < high)

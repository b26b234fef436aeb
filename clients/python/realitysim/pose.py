"""Poses of a camera, as matrices and as numbers."""

from __future__ import annotations

import math
from typing import Any, Dict

import numpy as np

__all__ = ["matrix_of_pose", "pose_of_camera"]


def pose_of_camera(map_from_camera: Any, z_forward: bool = False) -> Dict[str, float]:
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


def matrix_of_pose(position: Any, orientation: Any) -> np.ndarray:
    """map_from_camera, ... x 4 x 4, of positions (... x 3) and quaternions x y z w (... x 4): axes x forward, y left, z up."""
    position, turn = np.asarray(position, dtype=float), np.asarray(orientation, dtype=float)
    x, y, z, w = np.moveaxis(turn / np.linalg.norm(turn, axis=-1, keepdims=True), -1, 0)
    matrix = np.zeros((*position.shape[:-1], 4, 4))
    matrix[..., 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1)
    matrix[..., 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1)
    matrix[..., 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    matrix[..., :3, 3] = position
    matrix[..., 3, 3] = 1.0
    return matrix

"""Real camera images for any pose on the field, and captures with their tags, as numpy arrays.

    import realitysim

    with realitysim.open("captures/2026-11-21T10-00-00Z-robot") as capture:
        capture.tags.position                     # n x 3: where the camera was
        capture[42].image, capture[42].map_from_camera, capture.lens.matrix

    with realitysim.serve(db="images/") as client:        # or realitysim.Client("http://127.0.0.1:8765") of a running service
        view = client.view(x=0.3, y=-0.5, z=0.5, yaw_deg=30, pitch_deg=18, layers="image,depth,labels")
        view.image, view.depth, view.labels, view.lens, view.made

Poses are of ``camera_link`` in ``map``: x forward, y left, z up, metres; yaw, pitch, roll in degrees, pitch above 0 looks down.
A client holds one connection, so that a view costs no more than making it; use one for each thread, or ``AsyncClient``.
"""

from .aio import AsyncClient
from .camera import Camera
from .capture import Capture, Frame, Tags, open
from .client import Client
from .errors import (
    Busy,
    CaptureWarning,
    NotFound,
    ProgramError,
    RealitySimError,
    Refused,
    ServiceError,
    ServiceTimeout,
    Unreachable,
)
from .lens import Lens
from .perception import Detected, ErrorModel
from .pose import matrix_of_pose, pose_of_camera
from .service import serve
from .view import LABELS, View

__all__ = [
    "LABELS",
    "AsyncClient",
    "Busy",
    "Camera",
    "Capture",
    "CaptureWarning",
    "Client",
    "Detected",
    "ErrorModel",
    "Frame",
    "Lens",
    "NotFound",
    "ProgramError",
    "RealitySimError",
    "Refused",
    "ServiceError",
    "ServiceTimeout",
    "Tags",
    "Unreachable",
    "View",
    "matrix_of_pose",
    "open",
    "pose_of_camera",
    "serve",
]

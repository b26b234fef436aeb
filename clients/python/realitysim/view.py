"""A view and what it says of itself."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Optional

import numpy as np

from .lens import Lens
from .png import png

__all__ = ["LABELS", "View"]

LABELS = {0: "beyond", 1: "carpet", 2: "line", 3: "goal_frame", 4: "net", 5: "body", 255: "ignore"}
"""Names of the numbers in ``View.labels``."""

_LAYERS = ("image", "depth", "mask", "labels")


@dataclass
class View:
    """A picture and what it says of itself."""

    image: Optional[np.ndarray]
    """height x width x 3, uint8, R G B; height x width with mask="only"; None if ``layers`` leaves it out."""
    made: str
    """stored, nearest, warped or composed."""
    sources: List[Dict[str, Any]]
    """Images it was made of: source, stamp_ns, distance_m, angle_deg, share."""
    valid_share: float
    sure_share: float
    expected_error_px: Optional[float]
    """Of known geometry; None where none is shown."""
    lens: Lens
    """Intrinsic parameters of the view."""
    mask: Optional[np.ndarray] = None
    """height x width, uint8: 255 known geometry, 128 beyond the ground, 0 nothing; None with mask="none" or mask="only", or if
    ``layers`` leaves it out."""
    depth: Optional[np.ndarray] = None
    """height x width, float32, with ``layers``: metres along the unit ray of each pixel, not along the optical axis. inf where
    the picture is far or its distance unknown, NaN where the lens draws nothing."""
    labels: Optional[np.ndarray] = None
    """height x width, uint8, with ``layers``: classes of pixels, whose names are in ``LABELS``."""
    warning: Optional[str] = None
    """Set when the nearest image is farther away than allowed and outside="warn" was asked for."""
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)

    def _repr_png_(self) -> Optional[bytes]:
        return None if self.image is None else png(self.image)


def view_of(headers: Mapping[str, str], body: bytes) -> View:
    """The view of an answer; names of headers in small letters."""
    error = headers.get("realitysim-expected-error-px")
    return View(
        **_layers(headers, body),
        made=headers["realitysim-made"],
        sources=json.loads(headers["realitysim-sources"]),
        valid_share=float(headers["realitysim-valid-share"]),
        sure_share=float(headers["realitysim-sure-share"]),
        expected_error_px=float(error) if error else None,
        lens=Lens.of(json.loads(headers["realitysim-lens"])),
        warning=headers.get("realitysim-warning"),
        headers=headers,
    )


def _layers(headers: Mapping[str, str], body: bytes) -> Dict[str, Any]:
    if headers["content-type"] == "application/zip":
        with np.load(io.BytesIO(body)) as arrays:
            return {name: arrays[name] if name in arrays else None for name in _LAYERS}
    pixels = pixels_of(headers, body)
    return {
        "image": pixels[:, :, 0] if pixels.shape[2] == 1 else pixels[:, :, :3],
        "mask": pixels[:, :, 3] if pixels.shape[2] == 4 else None,
    }


def pixels_of(headers: Mapping[str, str], body: bytes) -> np.ndarray:
    """height x width x channels, uint8."""
    width, height, channels = (int(headers[f"realitysim-{name}"]) for name in ("width", "height", "channels"))
    return np.frombuffer(body, dtype=np.uint8).reshape(height, width, channels)

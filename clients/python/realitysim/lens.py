"""Intrinsic parameters of a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional

import numpy as np

__all__ = ["Lens"]


@dataclass(frozen=True)
class Lens:
    """A lens: pixels, and the model with its distortion coefficients by name, as lens files have them."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: str
    """The name of the model, such as ``kannala_brandt`` or ``plumb_bob``."""
    coefficients: Mapping[str, Any]
    """The model's own numbers, such as ``{"d": [0.0, ...]}``; empty for a model without any."""
    fov_deg: Optional[float] = None
    """Full field of view for which the model holds; None: as far as it can."""

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Lens":
        """The lens that the service describes, in ``realitysim-lens``, ``/v1/info`` or ``/v1/capture``."""
        model = values["model"]
        name, coefficients = (model, {}) if isinstance(model, str) else next(iter(model.items()))
        numbers: Dict[str, float] = {name: float(values[name]) for name in ("fx", "fy", "cx", "cy")}
        fov = values.get("fov_deg")
        return cls(int(values["width"]), int(values["height"]), **numbers, model=name, coefficients=coefficients or {}, fov_deg=fov)

    @property
    def matrix(self) -> np.ndarray:
        """The 3 x 3 camera matrix; of a pinhole lens without distortion it is the whole projection."""
        rows: List[List[float]] = [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]
        return np.array(rows)

"""Samples from an error model, its file being the argument, and holds what comes out against the numbers in it."""

import math
import sys

import numpy as np
from realitysim import ErrorModel

model = ErrorModel.load(sys.argv[1])
random = np.random.default_rng(5)
DRAWS = 4000

# The cell with the most landmarks, seen straight ahead by a camera that stands still at a height of 0.5 m.
name, cell = max(((n, c) for n, cells in model.classes.items() for c in cells if c["off_axis_deg"] is None), key=lambda p: p[1]["found"])
near, far = cell["distance_m"]
distance_m = (near + far) / 2
pose = {"x": 1.0, "y": -2.0, "z": 0.5, "yaw_deg": 90.0, "pitch_deg": math.degrees(math.atan2(0.5, distance_m))}
known = model.cell(name, distance_m, 0.0)
draws = [model.sample(random, [(name, 1.0, -2.0 + distance_m)], **pose) for _ in range(DRAWS)]
right = np.array([[one.bearing_deg, one.distance_m - distance_m] for draw in draws for one in draw if not one.is_false])
false_ones = sum(one.is_false for draw in draws for one in draw) / DRAWS

share, ground = known["detection_probability"]["value"], known["ground"]
assert abs(len(right) / DRAWS - share) < 4 * math.sqrt(share * (1 - share) / DRAWS) + 1e-9, (len(right), share)
for axis, bias in enumerate([ground["bearing_bias_deg"], ground["distance_bias_m"]]):
    sigma = math.sqrt(ground["covariance"][axis][axis])
    assert abs(right[:, axis].mean() - bias) < 4 * sigma / math.sqrt(len(right)) + 1e-9
    assert abs(right[:, axis].std() - sigma) < 0.1 * sigma + 1e-9
rate = sum(c["false_per_picture"]["value"] for cells in model.classes.values() for c in cells
           if c["off_axis_deg"] is None and c["speed_deg_s"] is None)
assert abs(false_ones - rate) < 4 * math.sqrt(rate / DRAWS) + 1e-9, (false_ones, rate)
assert model.cell(name, 1000.0, 0.0) is None or model.cell(name, 1000.0, 0.0)["distance_m"][1] is None
assert not [one for one in model.sample(random, [(name, 1.0, -3.0)], **pose) if not one.is_false], "behind the camera"
print("samples agree")

"""What the wheel brings: use_wheel.py CAPTURE"""

import sys

import realitysim

assert "site-packages" in realitysim.__file__, realitysim.__file__
with realitysim.open(sys.argv[1]) as capture:
    frame = next(frame for frame in capture if frame.valid)
    print(f"{len(capture)} frames, {capture.tags.valid.sum()} valid; the first: {frame.image.shape}, {frame.map_from_camera[:3, 3].round(3)}")

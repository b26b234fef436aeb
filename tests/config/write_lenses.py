"""Writes calibrations with OpenCV's FileStorage, and where OpenCV draws rays through them.

Arguments: a folder. For each lens there is a YAML and an XML file, and a line in rays.jsonl: name, and a list of [x, y, z, u, v].
"""

import json
import pathlib
import sys

import cv2
import numpy as np

folder = pathlib.Path(sys.argv[1])
random = np.random.default_rng(5)
matrix = np.array([[412.5, 0.0, 318.25], [0.0, 413.75, 241.5], [0.0, 0.0, 1.0]])


def coefficients(count):
    """k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, as plausible as a calibration's."""
    sizes = [0.3, 0.1, 0.003, 0.003, 0.02, 0.2, 0.05, 0.01, 0.003, 0.001, 0.003, 0.001]
    return random.uniform(-1, 1, count) * np.array(sizes[:count])


def write(name, distortion, fisheye):
    for ending in ("yml", "xml"):
        storage = cv2.FileStorage(str(folder / f"{name}.{ending}"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        if fisheye is not None:
            storage.write("fisheye_model", fisheye)
        storage.write("camera_matrix", matrix)
        storage.write("distortion_coefficients", distortion)
        storage.release()


with open(folder / "rays.jsonl", "w") as lines:
    for number in range(40):
        kind = number % 5
        count = [5, 8, 12, 4, 4][kind]
        is_fisheye = kind == 3
        distortion = random.uniform(-0.03, 0.03, 4) if is_fisheye else coefficients(count)
        name = f"lens{number}"
        write(name, distortion.reshape(1, -1), {3: 1, 4: 0}.get(kind))
        angle = random.uniform(0, 1.4 if is_fisheye else 0.75, 200)
        around = random.uniform(0, 2 * np.pi, 200)
        rays = np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=1)
        zero = np.zeros(3)
        if is_fisheye:
            pixels, _ = cv2.fisheye.projectPoints(rays.reshape(-1, 1, 3), zero, zero, matrix, distortion)
        else:
            pixels, _ = cv2.projectPoints(rays.reshape(-1, 1, 3), zero, zero, matrix, distortion)
        table = np.concatenate([rays, pixels.reshape(-1, 2)], axis=1)
        lines.write(json.dumps({"name": name, "rays": table.tolist()}) + "\n")

"""Reads exports for COLMAP and nerfstudio, and projects points as those programs do: arguments are both folders and the points' file.

The file holds, for each image, points of the field in metres and where they should be seen, in pixels of which the first has its centre
at (0, 0). Projection is OpenCV's. Prints the number of points and the largest distance in pixels.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np


def quaternion(w, x, y, z):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def project(points, rotation, translation, focal, centre, model, parameters):
    matrix = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
    points = np.asarray(points, float) @ rotation.T + translation
    assert (points[:, 2] > 0).all()
    still = np.zeros(3)
    if model == "OPENCV_FISHEYE":
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], still, still, matrix, np.array(parameters))
    else:
        pixels, _ = cv2.projectPoints(points[:, None], still, still, matrix, np.array(parameters))
    # The first pixel's centre is (0.5, 0.5) in both formats.
    return pixels[:, 0] - 0.5


def colmap(folder):
    rows = lambda name: [line.split() for line in (folder / "sparse/0" / name).read_text().splitlines() if line[:1] not in "#"]
    cameras = {row[0]: (row[1], [float(part) for part in row[4:]]) for row in rows("cameras.txt")}
    for row in rows("images.txt"):
        numbers = [float(part) for part in row[1:8]]
        model, [fx, fy, cx, cy, *rest] = cameras[row[8]]
        yield row[9], lambda points: project(
            points, quaternion(*numbers[:4]), np.array(numbers[4:]), (fx, fy), (cx, cy), model, rest
        )
    for row in rows("points3D.txt"):
        assert len(row) == 8 and all(0 <= int(part) <= 255 for part in row[4:7])


def nerfstudio(folder):
    transforms = json.loads((folder / "transforms.json").read_text())
    train, held = set(transforms["train_filenames"]), set(transforms["val_filenames"])
    assert held == set(transforms["test_filenames"]) and not train & held
    assert train | held == {frame["file_path"] for frame in transforms["frames"]}
    for frame in transforms["frames"]:
        pose = np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1])
        rotation = pose[:3, :3].T
        assert (folder / frame["file_path"]).is_file()
        mask = cv2.imread(str(folder / frame["mask_path"]), cv2.IMREAD_UNCHANGED)
        assert mask.shape == (frame["h"], frame["w"]) and set(np.unique(mask)) <= {0, 255}
        radial = [frame[key] for key in ("k1", "k2", "k3", "k4")]
        if frame["camera_model"] == "OPENCV":
            radial = [frame[key] for key in ("k1", "k2", "p1", "p2", "k3")]
        yield Path(frame["file_path"]).name, lambda points: project(
            points,
            rotation,
            -rotation @ pose[:3, 3],
            (frame["fl_x"], frame["fl_y"]),
            (frame["cx"], frame["cy"]),
            frame["camera_model"],
            radial,
        )
    assert (folder / transforms["ply_file_path"]).read_text().startswith("ply\n")


expected = json.loads(Path(sys.argv[3]).read_text())
worst, count = 0.0, 0
for images in (colmap(Path(sys.argv[1])), nerfstudio(Path(sys.argv[2]))):
    names = set()
    for name, projected in images:
        names.add(name)
        points, pixels = expected[name]
        if points:
            worst = max(worst, np.abs(projected(points) - np.array(pixels)).max())
            count += len(points)
    assert names
print(count, worst)

"""Reads labels with pycocotools and by the rules that Ultralytics documents: arguments are folders of the forms coco, yolo, yolo-seg,
yolo-pose and png of the same images.

Prints, as JSON, the number of images, and the intersection over union of line pixels with those that are white in the image, over all
pixels that are not ignored and lie in lines at least three pixels wide.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
from pycocotools.coco import COCO

coco_folder, yolo, yolo_seg, yolo_pose, png = map(Path, sys.argv[1:6])
coco = COCO(str(coco_folder / "annotations.json"))
category = {entry["name"]: entry["id"] for entry in coco.loadCats(coco.getCatIds())}
class_numbers = dict(line.split()[::-1] for line in (png / "classes.txt").read_text().splitlines())
field = coco.loadCats([category["field"]])[0]

sides = {}
both, either = 0, 0
for image in coco.loadImgs(coco.getImgIds()):
    width, height = image["width"], image["height"]
    picture = cv2.imread(str(coco_folder / "images" / image["file_name"]))
    assert picture.shape[:2] == (height, width)
    own = coco.loadAnns(coco.getAnnIds(imgIds=[image["id"]]))
    classes = cv2.imread(str(png / "classes" / Path(image["file_name"]).with_suffix(".png").name), cv2.IMREAD_UNCHANGED)
    covered = np.zeros((height, width), int)
    for name, number in class_numbers.items():
        entries = [entry for entry in own if entry["category_id"] == category[name]]
        assert len(entries) <= 1
        mask = classes == int(number)
        assert bool(entries) == mask.any()
        for entry in entries:
            decoded = coco.annToMask(entry).astype(bool)
            assert (decoded == mask).all() and decoded.sum() == entry["area"]
            rows, columns = np.nonzero(decoded)
            left, top, across, down = entry["bbox"]
            assert (left, top) == (columns.min(), rows.min())
            assert (left + across, top + down) == (columns.max() + 1, rows.max() + 1)
            covered += decoded
    assert (covered == 1).all(), "each pixel has one class"

    # Boxes: those of YOLO are the same.
    stem = Path(image["file_name"]).stem
    boxes = [line.split() for line in (yolo / "labels" / f"{stem}.txt").read_text().splitlines()]
    landmarks = [entry for entry in own if 10 <= entry["category_id"] < 20]
    assert len(boxes) == len(landmarks)
    for row, entry in zip(boxes, landmarks):
        assert len(row) == 5 and int(row[0]) == entry["category_id"] - 10
        x, y, across, down = map(float, row[1:])
        ours = [(x - across / 2) * width, (y - down / 2) * height, across * width, down * height]
        assert np.abs(np.array(ours) - entry["bbox"]).max() < 0.01
        assert all(0 <= part <= 1 for part in (x, y, across, down))

    # Keypoints: three numbers for each landmark, in both forms.
    (pose,) = [line.split() for line in (yolo_pose / "labels" / f"{stem}.txt").read_text().splitlines()] or [None]
    (entry,) = [entry for entry in own if entry["category_id"] == category["field"]]
    assert len(pose) == 5 + len(entry["keypoints"]) and len(entry["keypoints"]) == 3 * len(field["keypoints"])
    triples = np.array(entry["keypoints"]).reshape(-1, 3)
    theirs = np.array(pose[5:], float).reshape(-1, 3) * [width, height, 1]
    assert np.abs(triples - theirs).max() < 0.01
    assert entry["num_keypoints"] == (triples[:, 2] > 0).sum()

    # Outlines of lines lie in lines, or where something hides them.
    for line in (yolo_seg / "labels" / f"{stem}.txt").read_text().splitlines():
        number, *corners = line.split()
        assert number == "0" and len(corners) >= 6 and len(corners) % 2 == 0
        corners = np.array(corners, float).reshape(-1, 2)
        assert (corners >= 0).all() and (corners <= 1).all()
        filled = np.zeros((height, width), np.uint8)
        cv2.fillPoly(filled, [np.round(corners * [width, height] - 0.5).astype(np.int32)], 1)
        inside = classes[cv2.erode(filled, np.ones((3, 3))) == 1]
        known = inside[inside != 255]
        assert known.size == 0 or (known == int(class_numbers["line"])).mean() > 0.9

    # Against the picture: what is white on the carpet.
    smallest = picture.min(axis=2).astype(float)
    line = classes == int(class_numbers["line"])
    carpet = classes == int(class_numbers["carpet"])
    if line.sum() < 50:
        continue
    halfway = (np.median(smallest[line]) + np.median(smallest[carpet])) / 2
    white = (smallest > halfway) & (line | carpet)
    wide = cv2.dilate(cv2.morphologyEx((line | (classes == 255)).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))), np.ones((3, 3))) > 0
    both += (line & white & wide).sum()
    either += ((line | white) & wide).sum()
    sides[stem] = 1

data = (yolo_pose / "data.yaml").read_text()
(flip,) = [json.loads(line.split(":", 1)[1]) for line in data.splitlines() if line.startswith("flip_idx")]
assert [flip[other] for other in flip] == list(range(len(field["keypoints"])))
listed = [name for part in ("train.txt", "val.txt") for name in (yolo / part).read_text().split()]
assert sorted(listed) == sorted(f"./images/{image['file_name']}" for image in coco.loadImgs(coco.getImgIds()))
print(json.dumps({"images": len(coco.getImgIds()), "judged": len(sides), "iou": both / max(either, 1)}))

"""What OpenCV's aruco says of boards, as JSON: the second implementation of tests/replay/board.rs.

With a folder: for each picture in it, number and corners of every AprilTag 36h11 with a border of two bits. Without: for a
ChArUco board of 9 x 7 squares in three dictionaries, number and code of every marker in a square that is not at the rim.
"""

import json
import pathlib
import sys

import cv2


def tags(path):
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), parameters)
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    corners, numbers, _ = detector.detectMarkers(picture)
    if numbers is None:
        return []
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    exact = [cv2.cornerSubPix(picture, c.reshape(-1, 1, 2).copy(), (4, 4), (-1, -1), stop) for c in corners]
    return [[int(n), c.reshape(4, 2).tolist()] for n, c in zip(numbers.ravel(), exact)]


def codes(dictionary, bits):
    dictionary = cv2.aruco.getPredefinedDictionary(dictionary)
    board = cv2.aruco.CharucoBoard((9, 7), 0.06, 0.045, dictionary)
    found = []
    for number, corners in zip(board.getIds().ravel(), board.getObjPoints()):
        column, row = (int(corners[0][axis] / 0.06) for axis in (0, 1))
        if 0 < column < 8 and 0 < row < 6:
            marker = cv2.aruco.generateImageMarker(dictionary, int(number), bits + 2)[1:-1, 1:-1]
            found.append([int(number), int("".join("1" if value else "0" for value in marker.ravel()), 2)])
    return found


if len(sys.argv) > 1:
    print(json.dumps([tags(path) for path in sorted(pathlib.Path(sys.argv[1]).glob("*.png"))]))
else:
    aruco = cv2.aruco
    print(json.dumps([codes(aruco.DICT_4X4_250, 4), codes(aruco.DICT_5X5_250, 5), codes(aruco.DICT_6X6_250, 6)]))

"""Decodes raw images with OpenCV, as cv_bridge does, and writes for each case gray levels or R, G, B, without padding."""

import json
import sys
from pathlib import Path

import cv2
import numpy

COLOURS = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
}
SHARED_BY_TWO = {
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
    "yuyv": cv2.COLOR_YUV2RGB_YUYV,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
}
TWO_PLANES = {"nv12": cv2.COLOR_YUV2RGB_NV12, "nv21": cv2.COLOR_YUV2RGB_NV21}
# OpenCV names a mosaic by the second and third pixel of its second row; cv_bridge translates like this.
BAYER = {
    "bayer_rggb": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg": cv2.COLOR_BayerGB2RGB,
}


def decode(encoding, width, height, step, is_bigendian, data):
    rows = height * 3 // 2 if encoding in TWO_PLANES else height
    image = numpy.frombuffer(data, numpy.uint8).reshape(rows, step)
    if encoding in TWO_PLANES:
        return cv2.cvtColor(numpy.ascontiguousarray(image[:, :width]), TWO_PLANES[encoding])
    if encoding in COLOURS:
        channels, code = COLOURS[encoding]
        pixels = numpy.ascontiguousarray(image[:, : channels * width]).reshape(height, width, channels)
        return pixels if code is None else cv2.cvtColor(pixels, code)
    if encoding in SHARED_BY_TWO:
        pixels = numpy.ascontiguousarray(image[:, : 2 * width]).reshape(height, width, 2)
        return cv2.cvtColor(pixels, SHARED_BY_TWO[encoding])
    if encoding.endswith("16") or encoding == "16UC1":
        levels = numpy.ascontiguousarray(image[:, : 2 * width]).view(">u2" if is_bigendian else "<u2")
        image = (levels // 256).astype(numpy.uint8)
    else:
        image = numpy.ascontiguousarray(image[:, :width])
    code = BAYER.get(encoding.rstrip("0123456789"))
    return image if code is None else cv2.cvtColor(image, code)


def main():
    folder = Path(sys.argv[1])
    for number, case in enumerate(json.loads((folder / "cases.json").read_text())):
        pixels = decode(data=(folder / f"{number}.in").read_bytes(), **case)
        (folder / f"{number}.out").write_bytes(pixels.tobytes())


main()

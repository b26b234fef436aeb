"""The client against a served database of four images: check_client.py URL FIRST_IMAGE"""

import math
import socket
import sys
import threading
import time
import zlib

import numpy as np

from realitysim import Busy, Client, NotFound, RealitySimError, ServiceTimeout, Unreachable, pose_of_camera


def png(path):
    """8-bit R G B pixels of a PNG, with numpy alone."""
    data, at, idat = open(path, "rb").read(), 8, b""
    while at < len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        if kind == b"IHDR":
            width, height = (int.from_bytes(data[at + 8 + i : at + 12 + i], "big") for i in (0, 4))
        if kind == b"IDAT":
            idat += data[at + 8 : at + 8 + length]
        at += 12 + length
    rows = np.frombuffer(zlib.decompress(idat), np.uint8).reshape(height, 1 + 3 * width)
    out = np.zeros((height, 3 * width), np.uint8)
    for y, row in enumerate(rows):
        above = out[y - 1] if y else np.zeros(3 * width, np.uint8)
        for x in range(3 * width):
            a, b = int(out[y, x - 3]) if x > 2 else 0, int(above[x])
            c = int(above[x - 3]) if x > 2 else 0
            nearest = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            out[y, x] = (int(row[x + 1]) + [0, a, b, (a + b) // 2, nearest][row[0]]) % 256
    return out.reshape(height, width, 3)


url, first = sys.argv[1:]
client = Client(url)
view = client.view(x=0.1, y=0.2, z=0.5, yaw_deg=10, pitch_deg=20)
assert view.made == "stored" and view.image.shape == (240, 320, 3) and view.image.dtype == np.uint8, view
assert (view.image == png(first)).all(), "the stored image's own pixels"
view = client.view(x=0.22, y=0.2, z=0.5, yaw_deg=11, pitch_deg=20, mask="alpha", width=160)
assert view.image.shape == (120, 160, 3) and view.mask.shape == (120, 160), view
assert view.made == "composed" and len(view.sources) > 1 and view.valid_share > 0.9, view
# Layers are the same pixels as a picture, and depth is where the ray of the pixel meets the ground.
layers = client.view(x=0.22, y=0.2, z=0.5, yaw_deg=11, pitch_deg=20, layers="image,depth,mask", width=160)
assert (layers.image == view.image).all() and (layers.mask == view.mask).all(), layers
assert layers.depth.shape == (120, 160) and layers.depth.dtype == np.float32, layers
assert 0.3 < layers.depth[118, 80] < layers.depth[80, 80] < 5 and np.isinf(layers.depth[2, 80]), layers.depth[:, 80]
# Intrinsics are those of the view: half the size, half the focal length.
assert (view.lens.width, view.lens.height) == (160, 120), view.lens
full = client.view(x=0.22, y=0.2, z=0.5, yaw_deg=11, pitch_deg=20).lens
assert abs(2 * view.lens.fx - full.fx) < 1e-9 and full.matrix[0, 0] == full.fx and full.model, (view.lens, full)
labels = client.view(x=0.22, y=0.2, z=0.5, yaw_deg=11, pitch_deg=20, layers="labels,depth", width=160)
assert labels.image is None and labels.labels.shape == (120, 160) and labels.labels.dtype == np.uint8, labels
assert labels.labels[118, 80] in (1, 2, 255) and (labels.labels == 1).mean() > 0.05, np.unique(labels.labels, return_counts=True)
assert np.isfinite(labels.depth[np.isin(labels.labels, [1, 2])]).all(), "carpet and lines are on the ground"
only = client.view(x=0.22, y=0.2, z=0.5, yaw_deg=11, pitch_deg=20, layers="depth", width=160)
assert only.image is None and only.mask is None and np.array_equal(only.depth, layers.depth, equal_nan=True), only
try:
    client.view(x=9, y=9, z=0.5, yaw_deg=0)
    raise AssertionError("nothing is there")
except NotFound as error:
    assert isinstance(error, RealitySimError) and error.status == 404 and "farther than" in error.detail, error
assert client.view(x=3, y=0.2, z=0.5, yaw_deg=10, pitch_deg=20, outside="warn").warning

# A pose survives its matrix, in both conventions.
yaw, pitch, roll = 0.4, 0.3, -0.1
cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
turn = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
turn = turn @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
matrix = np.eye(4)
matrix[:3, :3], matrix[:3, 3] = turn, [0.2, 0.2, 0.5]
optical = matrix.copy()
optical[:3, :3] = np.stack([-turn[:, 1], -turn[:, 2], turn[:, 0]], axis=1)
for pose in (pose_of_camera(matrix), pose_of_camera(optical, z_forward=True)):
    for name, value in {"yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll}.items():
        assert abs(pose[name] - math.degrees(value)) < 1e-9, pose
assert client.view_of_matrix(matrix).image.shape == (240, 320, 3)

pose = {"x": 0.2, "y": 0.2, "z": 0.5, "yaw_deg": 10, "pitch_deg": 20}
views = list(client.views([pose, {**pose, "x": 50}, pose], width=64))
assert [type(view).__name__ for view in views] == ["View", "NotFound", "View"], views
assert views[0].image.shape == (48, 64, 3) and (views[0].image == views[2].image).all()
deep = list(client.views([pose, {**pose, "layers": "depth"}], width=64))
assert deep[0].depth is None and deep[1].image is None and deep[1].depth.shape == (48, 64), deep
assert len(list(client.trajectory(pose, {**pose, "x": 0.3}, count=7))) == 7
# Whoever has seen enough of a batch, or waited for too long, goes on.
next(client.views([pose, pose, pose]))
assert client.view(**pose).image.shape == (240, 320, 3)
assert client.views([{**pose, "x": np.float32(0.2)}]) is not None
silent = socket.create_server(("127.0.0.1", 0))
waiting = Client(f"http://127.0.0.1:{silent.getsockname()[1]}", timeout_s=0.2)
for _ in range(2):
    try:
        waiting.info()
        raise AssertionError("nobody answers")
    except ServiceTimeout as error:
        assert isinstance(error, TimeoutError)


def answers(*replies):
    """The address of a service that gives these answers, one for each request."""
    listening = socket.create_server(("127.0.0.1", 0))

    def serve():
        for reply in replies:
            connection, _ = listening.accept()
            with connection:
                connection.recv(65536)
                connection.sendall(reply)

    threading.Thread(target=serve, daemon=True).start()
    return f"http://127.0.0.1:{listening.getsockname()[1]}"


def http(status, headers, body):
    return f"HTTP/1.1 {status}\r\n{headers}Connection: close\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode()


# A busy service is asked again after the time that it names, and no longer than one has patience.
busy = http("503 Service Unavailable", "Retry-After: 1\r\n", '{"detail": "come back in a second"}')
began = time.monotonic()
assert Client(answers(busy, http("200 OK", "", "{}"))).info() == {} and time.monotonic() - began >= 1.0
try:
    Client(answers(busy), patience_s=0.5).info()
    raise AssertionError("it is busy")
except Busy as error:
    assert error.status == 503 and error.detail == "come back in a second", error
# A batch that breaks off is an error, and not a short batch.
torn = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/mixed; boundary=x\r\nConnection: close\r\n\r\n--x\r\ncontent-length: 9\r\n"
try:
    list(Client(answers(torn)).views([pose]))
    raise AssertionError("half of a part")
except Unreachable as error:
    assert isinstance(error, ConnectionError), error
assert client.info()["images"] == 4 and int(client.coverage().sum()) == 4
print("the client agrees")

"""What a robot's camera would have seen on its way: a circle around the middle of the database's images.

In a MuJoCo scene if `mujoco` is installed, else in a plain loop. Start `realitysim serve --db DIR` first.
"""

import argparse
import math
import time

import numpy as np

from realitysim import Client, ServiceError

SCENE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 4 0.1"/>
    <body name="robot" mocap="true" pos="0 0 0">
      <geom type="capsule" fromto="0 0 0.05 0 0 0.5" size="0.05" contype="0" conaffinity="0"/>
      <camera name="head" pos="0.05 0 {height}" xyaxes="0 -1 0 {sin} 0 {cos}"/>
    </body>
  </worldbody>
</mujoco>
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="http://127.0.0.1:8765")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--radius", type=float, default=0.5, help="metres")
    parser.add_argument("--center", type=float, nargs=2, default=None, help="x y; without it where most images are")
    parser.add_argument("--height", type=float, default=0.5, help="of the camera, metres")
    parser.add_argument("--pitch", type=float, default=20.0, help="degrees, downwards")
    parser.add_argument("--plain", action="store_true", help="without MuJoCo")
    parser.add_argument("-o", "--output", help="the last view, as a PPM picture")
    arguments = parser.parse_args()
    with Client(arguments.url) as client:
        center = arguments.center or busiest_place(client)
        cameras = plain_cameras(arguments, center) if arguments.plain else simulated_cameras(arguments, center)
        views, refused, started = [], 0, time.monotonic()
        for matrix in cameras:
            try:
                views.append(client.view_of_matrix(matrix, z_forward=True))
            except ServiceError as error:
                refused += 1
                print(error)
        seconds = time.monotonic() - started
    made = {name: sum(view.made == name for view in views) for name in {view.made for view in views}}
    print(f"{len(views)} views ({made}), {refused} refused, {1e3 * seconds / max(1, arguments.steps):.1f} ms each")
    if arguments.output and views:
        image = views[-1].image
        with open(arguments.output, "wb") as file:
            file.write(b"P6 %d %d 255\n" % (image.shape[1], image.shape[0]) + image.tobytes())


def busiest_place(client):
    cell_m = 0.25
    counts = client.coverage(cell_m=cell_m, headings=1)[:, :, 0]
    row, column = np.unravel_index(counts.argmax(), counts.shape)
    rows, columns = counts.shape
    return [(column + 0.5 - columns / 2) * cell_m, (row + 0.5 - rows / 2) * cell_m]


def way(arguments, center):
    """Place and heading of the robot, step by step."""
    for step in range(arguments.steps):
        angle = 2.0 * math.pi * step / arguments.steps
        x, y = center[0] + arguments.radius * math.cos(angle), center[1] + arguments.radius * math.sin(angle)
        yield x, y, angle + math.pi / 2


def plain_cameras(arguments, center):
    pitch = math.radians(arguments.pitch)
    for x, y, yaw in way(arguments, center):
        forward = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)])
        right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        matrix[:3, 3] = x, y, arguments.height
        yield matrix


def simulated_cameras(arguments, center):
    try:
        import mujoco
    except ImportError:
        print("mujoco is not installed (pip install mujoco): a plain loop instead")
        yield from plain_cameras(arguments, center)
        return
    pitch = math.radians(arguments.pitch)
    model = mujoco.MjModel.from_xml_string(SCENE.format(height=arguments.height, sin=math.sin(pitch), cos=math.cos(pitch)))
    data = mujoco.MjData(model)
    camera = model.camera("head").id
    for x, y, yaw in way(arguments, center):
        data.mocap_pos[0] = x, y, 0.0
        data.mocap_quat[0] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
        mujoco.mj_step(model, data)
        # MuJoCo's cameras: x right, y up, z backwards.
        turn = data.cam_xmat[camera].reshape(3, 3)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([turn[:, 0], -turn[:, 1], -turn[:, 2]], axis=1)
        matrix[:3, 3] = data.cam_xpos[camera]
        yield matrix


if __name__ == "__main__":
    main()

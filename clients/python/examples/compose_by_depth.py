"""A ball of another renderer in a view, hidden by what is in front of it and hiding what is behind.

Every renderer can give colour and depth of its own objects. A pixel shows the object if it is nearer than the view's depth
there. The renderer here is a few lines of numpy that know one ball; that of a simulator takes its place. Start
`realitysim serve --db DIR --lens pinhole=FILE` first, with the lens that the renderer has: `model = "plumb_bob"`, `d` all 0.
"""

import argparse
import sys

import numpy as np

from realitysim import Client


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", default="http://127.0.0.1:8765")
    parser.add_argument("--lens", default="pinhole", help="name of the pinhole lens that is served")
    parser.add_argument("--camera", type=float, nargs=5, required=True, metavar=("X", "Y", "Z", "YAW", "PITCH"), help="metres, degrees")
    parser.add_argument("--ball", type=float, nargs=3, required=True, metavar=("X", "Y", "Z"), help="its middle in map, metres")
    parser.add_argument("--radius", type=float, default=0.1, help="metres")
    parser.add_argument("-o", "--output", default="composed.ppm", help="the picture, as PPM")
    arguments = parser.parse_args()
    pose = dict(zip(("x", "y", "z", "yaw_deg", "pitch_deg"), arguments.camera))
    with Client(arguments.url) as client:
        lens = client.info()["lenses"][arguments.lens]
        view = client.view(**pose, lens=arguments.lens, layers="image,depth,mask")
    rays = rays_of_pinhole(lens)
    colour, depth = render_ball(rays @ rotation(pose).T, arguments.camera[:3], arguments.ball, arguments.radius)
    # Renderers measure depth along the optical axis, views along the ray: a ray of length r per metre of axis is r times longer.
    depth = depth * np.linalg.norm(rays, axis=2)
    # The comparison is false where the lens draws nothing; where the view is infinitely far, every object is in front.
    shows_ball = depth < view.depth
    picture = np.where(shows_ball[:, :, None], colour, view.image)
    write_ppm(arguments.output, picture)
    hidden = np.isfinite(depth) & ~shows_ball
    print(f"{shows_ball.sum()} pixels show the ball, {hidden.sum()} of it are hidden")


def rays_of_pinhole(lens):
    """Rays of all pixels with z = 1: x right, y down, z along the optical axis."""
    if any(lens["model"].get("plumb_bob", {"d": [1.0]})["d"]):
        sys.exit(f"this renderer has no lens distortion: serve a lens without, not {lens}")
    u, v = np.meshgrid(np.arange(lens["width"]), np.arange(lens["height"]))
    return np.stack([(u - lens["cx"]) / lens["fx"], (v - lens["cy"]) / lens["fy"], np.ones(u.shape)], axis=2)


def rotation(pose):
    """map_from_camera_optical_frame of a pose without roll: its columns are right, down and forward in map."""
    yaw, pitch = np.radians(pose["yaw_deg"]), np.radians(pose["pitch_deg"])
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def render_ball(rays, camera, middle, radius):
    """Colour, and depth along the optical axis (inf beside the ball), since the rays have a length of 1 along it."""
    to_middle = np.asarray(middle) - np.asarray(camera)
    squared, along = (rays**2).sum(axis=2), rays @ to_middle
    root = along**2 - squared * (to_middle @ to_middle - radius**2)
    with np.errstate(invalid="ignore"):
        depth = (along - np.sqrt(root)) / squared
    depth = np.where((root > 0) & (depth > 0), depth, np.inf)
    seen = np.where(np.isfinite(depth), depth, 0.0)[:, :, None] * rays - to_middle
    light = 0.4 + 0.6 * np.clip(seen[:, :, 2:] / radius, 0.0, 1.0)
    return (light * np.array([230, 110, 20])).astype(np.uint8), depth


def write_ppm(path, picture):
    with open(path, "wb") as file:
        file.write(b"P6 %d %d 255\n" % (picture.shape[1], picture.shape[0]) + picture.astype(np.uint8).tobytes())


if __name__ == "__main__":
    main()

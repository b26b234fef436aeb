"""Captures, an own service, coroutines and the camera: check_captures.py CAPTURE DATABASE"""

import asyncio
import sys
import warnings

import cv2
import numpy as np

import realitysim

folder, database = sys.argv[1:]
warnings.simplefilter("error")
with realitysim.open(folder) as capture:
    tags = capture.tags
    assert len(capture) == len(tags) > 20 and capture.lost == [] and tags.valid.mean() > 0.8, tags
    assert tags.stamp_ns.dtype == np.int64 and (np.diff(tags.stamp_ns) > 0).all() and tags.has_image.all()
    assert tags.covariance.shape == (len(tags), 6, 6) and (tags.reason[tags.valid] == "").all()
    frame = capture[-1]
    assert frame.index == len(capture) - 1 and frame.stamp_ns == tags.stamp_ns[-1], frame
    position = frame.tag["pose"]["pose"]["position"]
    assert [position[axis] for axis in "xyz"] == tags.position[-1].tolist(), "with every digit"
    pose = realitysim.pose_of_camera(frame.map_from_camera)
    for angle in ("yaw", "pitch", "roll"):
        assert abs(np.radians(pose[f"{angle}_deg"]) - frame.tag[angle]) < 1e-9, (angle, pose, frame.tag)
    assert frame.image.shape == (capture.lens.height, capture.lens.width, 3)
    recorded = capture._client._patiently("GET", f"/v1/frame?capture={capture.name}&frame={frame.index}", None)
    assert recorded.getheader("Content-Type") == "application/octet-stream" and recorded.read() == frame.image.tobytes()
    png = cv2.imdecode(np.frombuffer(frame._repr_png_(), np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    assert (png == frame.image).all(), "a notebook shows the pixels themselves"
    assert sum(1 for _ in capture) == len(capture)
    for wrong in (len(capture), -len(capture) - 1):
        try:
            capture[wrong]
            raise AssertionError(wrong)
        except IndexError:
            pass
for wrong in (folder + "/..", folder + "/none"):
    try:
        realitysim.open(wrong)
        raise AssertionError("no capture")
    except realitysim.RealitySimError as error:
        assert "no capture" in str(error), error
try:
    realitysim.serve(db=folder + "/none")
    raise AssertionError("no database")
except realitysim.ProgramError as error:
    assert "none" in str(error), error

with realitysim.serve(db=database) as client:
    start = [0.22, 0.2, 0.5, 11, 20, 0]
    camera = realitysim.Camera(client, start, layers="image,depth", width=160)
    observation, info = camera.reset(seed=1)
    assert observation["image"].shape == (120, 160, 3) and observation["depth"].shape == (120, 160), observation
    assert info["lens"].width == 160 and (camera.render() == observation["image"]).all()
    moved, reward, terminated, truncated, info = camera.step({"x": 0.25, "y": 0.2, "z": 0.5, "yaw_deg": 11, "pitch_deg": 20})
    assert reward == 0.0 and not terminated and not truncated and (moved["image"] != observation["image"]).any()
    *_, truncated, info = camera.step([9, 9, 0.5, 0, 0, 0])
    assert truncated and "farther than" in info["error"] and (camera.render() == moved["image"]).all(), info

    async def at_once():
        async with realitysim.AsyncClient(client.url, client.token, connections=2) as many:
            found = await asyncio.gather(*(many.view(*start, width=64) for _ in range(5)))
            batch = [view async for view in many.views([dict(zip(("x", "y", "z", "yaw_deg"), start))] * 2, width=64)]
            task = asyncio.ensure_future(many.view(*start))
            await asyncio.sleep(0)
            task.cancel()
            return found, batch, await many.info()

    views, batch, about = asyncio.run(at_once())
    assert all((view.image == views[0].image).all() for view in views) and len(batch) == 2 and about["images"] == 4
try:
    client.info()
    raise AssertionError("its service has ended")
except realitysim.Unreachable:
    pass
print("captures agree")

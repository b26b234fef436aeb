"""A viewer of `realitysim live --foxglove`: subscribes to every topic as Foxglove does, and decodes messages by the schemas that the server
tells. Says `subscribed`, `frames` once every topic has come, `away: WHY`, and `frames` again."""

import asyncio
import json
import struct
import sys

from mcap_ros2._dynamic import generate_dynamic
from websockets.asyncio.client import connect

TOPICS = {
    "/camera/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/camera/tagged_info": "sensor_msgs/msg/CameraInfo",
    "/camera/lines": "foxglove_msgs/msg/ImageAnnotations",
    "/camera/tf": "tf2_msgs/msg/TFMessage",
    "/camera/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/frame_tag": "realitysim_msgs/msg/FrameTag",
    "/field/lines": "visualization_msgs/msg/MarkerArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
OK, ERROR = 0, 2
MESSAGE_DATA = 1


def say(words):
    print(words, flush=True)


def stamp_ns(stamp):
    return 10**9 * stamp.sec + stamp.nanosec


async def subscribed(socket):
    """Subscribes to all topics. Returns topic and decoder by the number of the subscription."""
    topics = {}
    while len(topics) < len(TOPICS):
        told = await socket.recv()
        told = json.loads(told) if isinstance(told, str) else {}
        if told.get("op") != "advertise":
            continue
        for channel in told["channels"]:
            name = channel["schemaName"]
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg"), channel
            assert TOPICS[channel["topic"]] == name, channel
            topics[channel["id"]] = channel["topic"], generate_dynamic(name, channel["schema"])[name]
    subscriptions = [{"id": number, "channelId": number} for number in topics]
    await socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
    return topics


async def messages(socket, topics):
    async for data in socket:
        if isinstance(data, bytes) and data[0] == MESSAGE_DATA:
            subscription, log_time_ns = struct.unpack_from("<IQ", data, 1)
            topic, decode = topics[subscription]
            yield topic, log_time_ns, decode(data[13:])


def check(topic, time_ns, message):
    """Checks one message by itself. Returns the stamp of the image that it belongs to, if it belongs to one."""
    if topic == "/camera/image/compressed":
        assert bytes(message.data[:2]) == b"\xff\xd8" and message.format == "jpeg"
        assert message.header.frame_id == "tagged_camera_optical"
    elif topic == "/camera/lines":
        assert all(line.type == 3 and len(line.points) > 1 for line in message.points)
        stamp = message.texts[0].timestamp
        assert time_ns == stamp_ns(stamp)
        return time_ns
    elif topic == "/camera/tf":
        parents = {transform.child_frame_id: transform.header.frame_id for transform in message.transforms}
        assert parents == {"tagged_camera": "map", "tagged_camera_optical": "tagged_camera"}, parents
        return None
    elif topic == "/camera/pose":
        assert message.header.frame_id == "map" and message.pose.covariance[0] > 0
    elif topic == "/field/lines":
        marker = message.markers[0]
        assert marker.type == 5 and marker.header.frame_id == "map" and len(marker.points) > 100
        return None
    elif topic == "/diagnostics":
        return None
    assert time_ns == stamp_ns(message.header.stamp), topic
    return time_ns


async def view(url):
    async with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        topics = await subscribed(socket)
        say("subscribed")
        rounds, seen, stamps, latest = 0, set(), {}, 0
        async for topic, time_ns, message in messages(socket, topics):
            stamp = check(topic, time_ns, message)
            level = message.status[0].level if topic == "/diagnostics" else OK
            is_away = (level[0] if isinstance(level, bytes) else level) == ERROR
            if is_away and rounds == 1:
                rounds, seen, stamps = 2, set(), {}
                say(f"away: {message.status[0].message}")
                latest = time_ns
            elif rounds != 1 and not is_away and (stamp is None or stamp > latest):
                seen.add(topic)
                if stamp is not None:
                    stamps.setdefault(stamp, set()).add(topic)
            whole = any({"/camera/image/compressed", "/camera/lines", "/camera/pose"} <= of for of in stamps.values())
            if seen == set(TOPICS) and whole:
                say("frames")
                if rounds == 2:
                    return
                rounds, seen, stamps = 1, set(), {}


asyncio.run(view(sys.argv[1]))

"""Decodes every message of a log for viewers with the readers of mcap, and joins its transforms: images must stand on the field."""

import sys
from collections import Counter

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

counts, parents, frames = Counter(), {}, set()
with open(sys.argv[1], "rb") as file:
    for schema, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
        counts[channel.topic] += 1
        if schema.name == "tf2_msgs/msg/TFMessage":
            for transform in message.transforms:
                child, parent = transform.child_frame_id, transform.header.frame_id
                assert parents.setdefault(child, parent) == parent, f"{child} has two parents"
        elif schema.name == "sensor_msgs/msg/CompressedImage":
            frames.add(message.header.frame_id)
        elif schema.name == "foxglove_msgs/msg/ImageAnnotations":
            assert all(line.type == 3 and len(line.points) > 1 for line in message.points)
        elif schema.name == "visualization_msgs/msg/MarkerArray":
            assert message.markers[0].type == 5

assert counts["/field/lines"] == 1 and counts["/camera/lines"] == counts["/frame_tag"] > 0, counts
for frame in frames:
    path = [frame]
    while path[-1] in parents:
        path.append(parents[path[-1]])
    assert path[-1] == "map", path

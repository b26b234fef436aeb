"""Reads every message of a capture with mcap-ros2-support and with rosbags, and compares with what Rust found."""

import json
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TAG, POSE = "/frame_tag", "/camera/pose"


class Found:
    """What a reader found, in the order of the files."""

    def __init__(self):
        self.counts = Counter()
        self.images, self.poses, self.valid, self.frames = [], [], [], []

    def add(self, topic, image_topic, message):
        self.counts[topic] += 1
        if topic == image_topic:
            self.images.append(bytes(message.data))
        elif topic == POSE:
            self.poses.append(stamp(message))
        elif topic == TAG:
            self.frames.append(stamp(message))
            if message.valid:
                self.valid.append(stamp(message))

    def compare(self, expected, source_images):
        assert dict(self.counts) == expected["counts"], (self.counts, expected["counts"])
        assert self.images == source_images, "image bytes differ from those of the source"
        assert self.frames == expected["frames"], "stamps of the tags differ"
        assert self.valid == expected["valid"], "stamps of the valid tags differ"
        assert self.poses == self.valid, "stamps of the poses are not those of the valid tags"


def stamp(message):
    return f"{message.header.stamp.sec}.{message.header.stamp.nanosec:09}"


def read_with_mcap(files, image_topic):
    found = Found()
    for name in files:
        with open(name, "rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            assert reader.get_header().profile == "ros2"
            for _, channel, _, message in reader.iter_decoded_messages():
                found.add(channel.topic, image_topic, message)
            for attachment in reader.iter_attachments():
                assert attachment.name == "filter_state", attachment.name
    return found


def read_with_rosbags(path, image_topic, found):
    # Empty, so that every type comes from the definitions in the log.
    store = get_typestore(Stores.EMPTY)
    with Reader(Path(path)) as reader:
        for connection in reader.connections:
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
        announced = {topic: info.msgcount for topic, info in reader.topics.items()}
        before = Counter(found.counts)
        for connection, _, raw in reader.messages():
            found.add(connection.topic, image_topic, store.deserialize_cdr(raw, connection.msgtype))
        read = {topic: count - before[topic] for topic, count in found.counts.items() if count > before[topic]}
        assert announced == read, f"announced {announced}, read {read}"
        assert reader.message_count == sum(read.values())
    return found


if __name__ == "__main__":
    session, source, expected = Path(sys.argv[1]), sys.argv[2], json.loads(Path(sys.argv[3]).read_text())
    image_topic = expected["image_topic"]
    source_images = read_with_mcap([source], image_topic).images
    assert len(source_images) == len(expected["frames"])

    read_with_mcap(expected["files"], image_topic).compare(expected, source_images)
    print("mcap-ros2-support: the files agree")

    assert (session / "metadata.yaml").is_file()
    read_with_rosbags(session, image_topic, Found()).compare(expected, source_images)
    print("rosbags: the folder agrees")

    singly = Found()
    for name in expected["files"]:
        read_with_rosbags(name, image_topic, singly)
    singly.compare(expected, source_images)
    print("rosbags: each file by itself agrees")

"""Writes a ROS 2 log again with Foxglove's schemas in protobuf: with Foxglove's SDK, or with the MCAP library and protobuf.

What has no schema of Foxglove stays ROS 2, as in logs of robots that mix both.
"""

import sys

import foxglove
from foxglove import channels as sdk_channels
from foxglove import messages as sdk
from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    CompressedImage_pb2,
    FrameTransform_pb2,
    FrameTransforms_pb2,
    JointStates_pb2,
    Odometry_pb2,
    PoseInFrame_pb2,
    RawImage_pb2,
)
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema
from mcap_ros2.decoder import DecoderFactory


class Protobuf:
    """Makes messages of foxglove-schemas-protobuf, and writes them with the MCAP library."""

    def __init__(self, path):
        self.writer = Writer(path)
        self.writer.start("", "tests/replay/to_foxglove.py")
        self.channels = {}

    def time(self, stamp):
        return {"seconds": stamp.sec, "nanos": stamp.nanosec}

    def make(self, name, /, **fields):
        modules = {
            "CameraCalibration": CameraCalibration_pb2,
            "CompressedImage": CompressedImage_pb2,
            "FrameTransform": FrameTransform_pb2,
            "FrameTransforms": FrameTransforms_pb2,
            "JointStates": JointStates_pb2,
            "Odometry": Odometry_pb2,
            "PoseInFrame": PoseInFrame_pb2,
            "RawImage": RawImage_pb2,
        }
        # Parts are made of dictionaries.
        return getattr(modules[name], name)(**fields) if name in modules else fields

    def channel(self, topic, schema, encoding, metadata):
        return self.writer.register_channel(topic, encoding, schema, metadata)

    def write(self, topic, message, time):
        if topic not in self.channels:
            self.channels[topic] = self.channel(topic, register_schema(self.writer, type(message)), "protobuf", {})
        self.writer.add_message(self.channels[topic], time, message.SerializeToString(), time)

    def pass_on(self, schema, channel, message):
        if channel.topic not in self.channels:
            kept = self.writer.register_schema(schema.name, schema.encoding, schema.data)
            self.channels[channel.topic] = self.channel(channel.topic, kept, channel.message_encoding, channel.metadata)
        self.writer.add_message(self.channels[channel.topic], message.log_time, message.data, message.publish_time)

    def close(self):
        self.writer.finish()


class Sdk:
    """Makes and writes messages of foxglove-sdk."""

    def __init__(self, path):
        self.sink = foxglove.open_mcap(path, allow_overwrite=True)
        self.channels = {}

    def time(self, stamp):
        return sdk.Timestamp(sec=stamp.sec, nsec=stamp.nanosec)

    def make(self, name, /, **fields):
        return getattr(sdk, name)(**fields)

    def write(self, topic, message, time):
        if topic not in self.channels:
            self.channels[topic] = getattr(sdk_channels, type(message).__name__ + "Channel")(topic)
        self.channels[topic].log(message, log_time=time)

    def pass_on(self, schema, channel, message):
        if channel.topic not in self.channels:
            kept = foxglove.Schema(name=schema.name, encoding=schema.encoding, data=schema.data)
            self.channels[channel.topic] = foxglove.Channel(
                channel.topic, schema=kept, message_encoding=channel.message_encoding, metadata=channel.metadata
            )
        self.channels[channel.topic].log(message.data, log_time=message.log_time)

    def close(self):
        self.sink.close()


def convert(to, message, kind, is_moving):
    """Makes the message of Foxglove's that says the same; `None` if there is none."""

    def vector(v):
        return to.make("Vector3", x=v.x, y=v.y, z=v.z)

    def quaternion(q):
        return to.make("Quaternion", x=q.x, y=q.y, z=q.z, w=q.w)

    def pose(p):
        return to.make("Pose", position=vector(p.position), orientation=quaternion(p.orientation))

    def transform(t):
        fields = {"parent_frame_id": t.header.frame_id, "child_frame_id": t.child_frame_id}
        translation, rotation = vector(t.transform.translation), quaternion(t.transform.rotation)
        time = to.time(t.header.stamp)
        return to.make("FrameTransform", timestamp=time, translation=translation, rotation=rotation, **fields)

    if kind == "TFMessage" and is_moving:
        assert len(message.transforms) == 1
        return transform(message.transforms[0])
    if kind == "TFMessage":
        return to.make("FrameTransforms", transforms=[transform(t) for t in message.transforms])
    head = {"timestamp": to.time(message.header.stamp), "frame_id": message.header.frame_id}
    if kind == "CompressedImage":
        return to.make(kind, data=bytes(message.data), format=message.format, **head)
    if kind == "Image":
        size = {"width": message.width, "height": message.height, "step": message.step}
        return to.make("RawImage", encoding=message.encoding, data=bytes(message.data), **size, **head)
    if kind == "CameraInfo":
        size = {"width": message.width, "height": message.height}
        numbers = {name: list(getattr(message, name.lower())) for name in "DKRP"}
        return to.make("CameraCalibration", distortion_model=message.distortion_model, **size, **numbers, **head)
    if kind == "PoseStamped":
        return to.make("PoseInFrame", pose=pose(message.pose), **head)
    if kind == "Odometry":
        twist = message.twist.twist
        return to.make(
            "Odometry",
            body_frame_id=message.child_frame_id,
            pose=pose(message.pose.pose),
            linear_velocity=vector(twist.linear),
            angular_velocity=vector(twist.angular),
            pose_covariance=list(message.pose.covariance),
            velocity_covariance=list(message.twist.covariance),
            **head,
        )
    if kind == "JointState":
        joints = zip(message.name, message.position)
        joints = [to.make("JointState", name=name, position=position) for name, position in joints]
        return to.make("JointStates", timestamp=head["timestamp"], joints=joints)
    return None


def main():
    source, target, writer = sys.argv[1:]
    to = {"sdk": Sdk, "protobuf": Protobuf}[writer](target)
    with open(source, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            kind = schema.name.rsplit("/")[-1]
            converted = convert(to, decoded, kind, is_moving=channel.topic == "/tf")
            if converted is None:
                to.pass_on(schema, channel, message)
            else:
                to.write(channel.topic, converted, message.log_time)
    to.close()


main()

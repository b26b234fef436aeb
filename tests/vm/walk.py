"""A walk with known truth for the virtual machine: its frames as the kernel's video output takes them, its measurements as
MAVLink, and what a capture must then hold.

The world moves in steps: while a frame is shown, odometry and attitude are those of its moment. So every recorded frame has a
known true pose, whenever it was taken.
"""
import os
import pathlib
import socket
import threading
import time

os.environ["MAVLINK20"] = "1"
import numpy  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from mcap.stream_reader import StreamReader  # noqa: E402
from mcap_ros2.decoder import DecoderFactory  # noqa: E402
from mcap_ros2.writer import Writer  # noqa: E402
from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

NAN = [float("nan")] * 21
FLU = mavlink.MAV_FRAME_LOCAL_FLU


class Walk:
    """Of a log that `realitysim scene render` made without JPEG."""

    def __init__(self, log):
        self.frames, self.truths, odometry, attitude = [], [], [], []
        self.texts = {}
        with open(log, "rb") as file:
            for schema, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
                if channel.topic == "/camera/image_raw":
                    self.frames.append((ns(message.header.stamp), yuyv(message)))
                elif channel.topic == "/odom":
                    odometry.append((ns(message.header.stamp), message))
                elif channel.topic == "/imu/data":
                    attitude.append((ns(message.header.stamp), message))
                elif channel.topic == "/ground_truth/camera_pose":
                    self.truths.append(message)
                    self.truth_text = schema.data.decode()
        nearest = lambda samples, at: min(samples, key=lambda sample: abs(sample[0] - at))[1]
        self.odometry = [nearest(odometry, at) for at, _ in self.frames]
        self.attitude = [nearest(attitude, at) for at, _ in self.frames]
        self.number = {data: index for index, (_, data) in enumerate(self.frames)}

    def write_disk(self, path):
        pathlib.Path(path).write_bytes(b"".join(data for _, data in self.frames))

    def write_truth(self, path, recorded):
        """The true pose of each recorded frame, by what is in it; frames of no walk have none."""
        with open(path, "wb") as file:
            writer = Writer(file)
            schema = writer.register_msgdef("geometry_msgs/msg/PoseStamped", self.truth_text)
            known = 0
            for stamp_ns, data in recorded:
                number = self.number.get(data)
                if number is None:
                    continue
                known += 1
                truth = self.truths[number]
                stamp = {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}
                writer.write_message("/ground_truth/camera_pose", schema,
                                     {"header": {"stamp": stamp, "frame_id": truth.header.frame_id}, "pose": truth.pose},
                                     log_time=stamp_ns, publish_time=stamp_ns)
            writer.finish()
        return known


def ns(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def yuyv(image):
    """BT.601 as in JFIF: two pixels share their chroma."""
    rgb = numpy.frombuffer(bytes(image.data), numpy.uint8).reshape(image.height, image.width, 3).astype(numpy.float64)
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    y = 0.299 * r + 0.587 * g + 0.114 * b
    pairs = lambda plane: (plane[:, ::2] + plane[:, 1::2]) / 2
    u, v = pairs(128 + (b - y) / 1.772), pairs(128 + (r - y) / 1.402)
    out = numpy.empty((image.height, image.width, 2))
    out[..., 0] = y
    out[:, ::2, 1], out[:, 1::2, 1] = u, v
    return numpy.clip(numpy.rint(out), 0, 255).astype(numpy.uint8).tobytes()


def recorded(session, topics):
    """Messages of a capture as an independent reader finds them, segments that were never finished included."""
    out = []
    for path in sorted(pathlib.Path(session).glob("*.mcap*")):
        decoders, channels, schemas = {}, {}, {}
        try:
            with open(path, "rb") as file:
                for record in StreamReader(file).records:
                    kind = type(record).__name__
                    if kind == "Schema":
                        schemas[record.id] = record
                    elif kind == "Channel":
                        channels[record.id] = record
                    elif kind == "Message" and channels[record.channel_id].topic in topics:
                        channel = channels[record.channel_id]
                        if channel.id not in decoders:
                            decoders[channel.id] = DecoderFactory().decoder_for("cdr", schemas[channel.schema_id])
                        out.append((channel.topic, decoders[channel.id](record.data)))
        except Exception as error:  # noqa: BLE001: whatever a torn end does to that reader, what came before it counts
            print(f"  {path.name}: {type(error).__name__} at its end", flush=True)
    return out


class Microcontroller(threading.Thread):
    """At the other end of a serial line, with a clock of its own. Nothing paces the machine's lines but this."""

    def __init__(self, link, walk, rate_hz=20):
        super().__init__(daemon=True)
        self.link, self.walk, self.period = link, walk, 1 / rate_hz
        # A wire holds no more than a few messages: what is in it when it is cut was not received.
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
        self.mavlink = mavlink.MAVLink(self, srcSystem=1, srcComponent=1)
        self.began = time.monotonic()
        self.number = 0
        # When which odometry was taken: its vz counts.
        self.sent = []
        self.is_taken = False
        self.going = True

    def write(self, data):
        """As a UART: what nobody takes is lost. Before the service opens its port, the line is full."""
        self.link.settimeout(0.02)
        try:
            self.link.sendall(data)
            self.is_taken = True
        except TimeoutError:
            self.is_taken = False

    def device_ns(self):
        return int((time.monotonic() - self.began + 100) * 1e9)

    def run(self):
        tick = 0
        try:
            while self.going:
                self.send(tick)
                tick += 1
                while (left := self.began + tick * self.period - time.monotonic()) > 0:
                    self.answer(left)
        except OSError:
            # The machine is off.
            pass

    def send(self, tick):
        now = self.device_ns()
        if tick % 20 == 0:
            self.mavlink.heartbeat_send(mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        attitude, odometry = self.walk.attitude[self.number], self.walk.odometry[self.number]
        self.mavlink.attitude_quaternion_send(now // 1_000_000, *ned_from_frd(attitude.orientation), 0, 0, 0)
        p, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        count = len(self.sent)
        self.mavlink.odometry_send(now // 1_000, FLU, FLU, p.x, p.y, p.z, [q.w, q.x, q.y, q.z], 0, 0, count, 0, 0, 0, NAN, NAN)
        if self.is_taken:
            self.sent.append(time.monotonic())

    def answer(self, seconds):
        """To questions for the time, at once."""
        self.link.settimeout(seconds)
        try:
            for message in self.mavlink.parse_buffer(self.link.recv(4096)) or []:
                if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    self.mavlink.timesync_send(self.device_ns(), message.ts1)
        except (TimeoutError, mavlink.MAVError):
            pass

    def stop(self):
        self.going = False
        self.join(5)
        self.link.close()


class Relay(threading.Thread):
    """A wire from one line to the other. What the other sends is read and dropped: QEMU stands still once nobody takes it."""

    def __init__(self, source, target):
        super().__init__(daemon=True)
        self.source, self.target = source, target
        self.drain = threading.Thread(target=self.drop, daemon=True)

    def drop(self):
        try:
            while self.target.recv(4096):
                pass
        except OSError:
            # Unplugged.
            pass

    def run(self):
        self.drain.start()
        try:
            while data := self.source.recv(4096):
                self.target.sendall(data)
        except OSError:
            # Unplugged.
            pass

    def stop(self):
        for line in (self.source, self.target):
            line.shutdown(socket.SHUT_RDWR)
        self.join(5)
        self.drain.join(5)
        self.source.close()
        self.target.close()


def ned_from_frd(q):
    """An attitude of REP 103 (FLU in ENU) as aviation says it: w, x, y, z."""
    h = 0.5 ** 0.5
    times = lambda a, b: (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                          a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                          a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
                          a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0])
    return times(times((0, h, h, 0), (q.w, q.x, q.y, q.z)), (0, 1, 0, 0))

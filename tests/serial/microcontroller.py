"""A robot's microcontroller on a pty, speaking MAVLink through pymavlink: `microcontroller.py TTY SECONDS [CORRUPT_PERCENT]`.

Prints one line of JSON at the end: what it sent, and how its clock stands to the host's.
"""
import json
import os
import random
import select
import sys
import time
import tty

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

DRIFT = 80e-6
STARTED = time.monotonic()


def device_s():
    """The quartz runs a little fast, and began when the device was switched on."""
    return (time.monotonic() - STARTED) * (1 + DRIFT) + 5.0


FLU, FRD, NED = mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_LOCAL_NED
BODY = mavlink.MAV_FRAME_BODY_FRD
HALF = 0.5 ** 0.5
# The same walk along x, 0.5 m to its left: x is forward, or east of what the compass says.
as_seen_in = [
    lambda x, y: (FLU, FLU, (x, y, 0), [1, 0, 0, 0]),
    lambda x, y: (FRD, BODY, (x, -y, 0), [1, 0, 0, 0]),
    lambda x, y: (NED, BODY, (y, x, 0), [HALF, 0, 0, HALF]),
]


class Wire:
    def __init__(self, fd, percent):
        self.fd, self.percent, self.noise = fd, percent, random.Random(1)

    def write(self, data):
        if self.percent:
            hit = lambda byte: byte ^ self.noise.randrange(1, 256)
            data = bytes(hit(b) if self.noise.random() * 100 < self.percent else b for b in data)
        os.write(self.fd, data)


def main():
    path, seconds = sys.argv[1], float(sys.argv[2])
    percent = float(sys.argv[3]) if len(sys.argv) > 3 else 0.0
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    link = mavlink.MAVLink(Wire(fd, percent), srcSystem=1, srcComponent=1)
    sent, asked, tick = {}, 0, 0
    count = lambda name: sent.__setitem__(name, sent.get(name, 0) + 1)
    while time.monotonic() - STARTED < seconds:
        now = device_s()
        ms, us = int(now * 1e3), int(now * 1e6)
        if tick % 100 == 0:
            link.heartbeat_send(mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)
            count("HEARTBEAT")
        link.attitude_quaternion_send(ms, 1, 0, 0, 0, 0, 0, 0)
        count("ATTITUDE_QUATERNION")
        link.highres_imu_send(us, 0, 0, -9.81, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 63)
        count("HIGHRES_IMU")
        if tick % 2 == 0:
            nan = [float("nan")] * 21
            frame, child, place, facing = as_seen_in[tick // 2 % 3](0.1 * now, 0.5)
            link.odometry_send(us, frame, child, *place, facing, 0.1, 0, 0, 0, 0, 0, nan, nan)
            count("ODOMETRY")
            flags = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
            # Yaw to the right by 0.2 rad.
            link.gimbal_device_attitude_status_send(0, 0, ms, flags, [0.995004, 0, 0, 0.099833], 0, 0, 0, 0)
            count("GIMBAL_DEVICE_ATTITUDE_STATUS")
        tick += 1
        until = STARTED + tick * 0.01
        while True:
            wait = until - time.monotonic()
            if wait <= 0 or not select.select([fd], [], [], wait)[0]:
                break
            for message in link.parse_buffer(os.read(fd, 4096)) or []:
                if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    link.timesync_send(int(device_s() * 1e9), message.ts1)
                    count("TIMESYNC")
                    asked += 1
    print(json.dumps({"sent": sent, "asked": asked, "offset_ns": int((time.monotonic() - device_s()) * 1e9)}))


main()

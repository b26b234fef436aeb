"""Boots the virtual machine of build.sh and tries the service in it: `run.py FOLDER`. Exit code 0 only if all of it ran.

On the host pymavlink plays the microcontroller at the machine's second serial line.
"""
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

FOLDER = sys.argv[1]
SOCKET = "--socket /run/realitysim/control.sock"


def connect(name, patience=30):
    until = time.monotonic() + patience
    while True:
        try:
            link = socket.socket(socket.AF_UNIX)
            link.connect(os.path.join(FOLDER, name))
            return link
        except OSError:
            link.close()
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


class Machine:
    def __init__(self):
        for name in ("s1.sock", "s2.sock"):
            if os.path.exists(os.path.join(FOLDER, name)):
                os.remove(os.path.join(FOLDER, name))
        self.qemu = subprocess.Popen(
            ["qemu-system-x86_64", "-M", "pc", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "768",
             "-nodefaults", "-no-reboot", "-display", "none", "-kernel", "vmlinuz", "-initrd", "initrd.gz",
             "-append", "console=ttyS0 quiet panic=-1 mitigations=off", "-serial", "file:console.log",
             "-chardev", "socket,id=s1,path=s1.sock,server=on,wait=off", "-serial", "chardev:s1",
             "-chardev", "socket,id=s2,path=s2.sock,server=on,wait=off", "-serial", "chardev:s2",
             "-drive", "file=root.qcow2,format=qcow2,if=virtio", "-device", "virtio-rng-pci"], cwd=FOLDER)
        self.shell = connect("s2.sock")
        self.text = ""
        self.count = 0

    def boot(self):
        until = time.monotonic() + 180
        while time.monotonic() < until:
            self.shell.sendall(b"true\n")
            if self.wait(r"# ?$", 2):
                break
        self.shell.sendall(b"stty -echo; PS1=\n")
        time.sleep(1)
        self.run("true", 60)

    def wait(self, pattern, seconds):
        until = time.monotonic() + seconds
        self.shell.settimeout(0.2)
        while time.monotonic() < until:
            found = re.search(pattern, self.text, re.MULTILINE)
            if found:
                before, self.text = self.text[:found.start()], self.text[found.end():]
                return before, found
            try:
                data = self.shell.recv(65536)
                self.text += data.decode(errors="replace").replace("\r", "")
            except TimeoutError:
                pass
        return None

    def run(self, command, seconds=60):
        """Exit code and output."""
        self.count += 1
        mark = f"__M{self.count}_"
        self.text = ""
        self.shell.sendall(f"{command}; echo {mark[:3]}''{mark[3:]}$?_\n".encode())
        answer = self.wait(mark + r"(\d+)_\n", seconds)
        if not answer:
            raise SystemExit(f"no answer within {seconds} s to: {command}\n{self.text[-2000:]}")
        before, found = answer
        return int(found.group(1)), before.strip()

    def ok(self, command, seconds=60):
        code, text = self.run(command, seconds)
        assert code == 0, f"{command}: {code}\n{text}"
        return text

    def status(self):
        code, text = self.run(f"realitysim status --json {SOCKET}", 60)
        return json.loads(text.splitlines()[-1]) if code == 0 else None

    def until(self, what, seconds, holds):
        began = time.monotonic()
        status = None
        while time.monotonic() - began < seconds:
            status = self.status()
            if status and holds(status):
                print(f"+ {what}: {time.monotonic() - began:.1f} s", flush=True)
                return status
            time.sleep(0.3)
        raise SystemExit(f"- {what}: not within {seconds} s; {json.dumps(status)}\n"
                         + self.run("journalctl -u realitysim -n 40 --no-pager -o cat")[1])


class Microcontroller(threading.Thread):
    """At the machine's ttyS1: nothing paces that line but we."""

    def __init__(self):
        super().__init__(daemon=True)
        self.link = connect("s1.sock")
        self.mavlink = mavlink.MAVLink(self, srcSystem=1, srcComponent=1)
        self.began = time.monotonic()

    def write(self, data):
        self.link.sendall(data)

    def device_ns(self):
        return int((time.monotonic() - self.began + 100) * 1e9)

    def run(self):
        self.link.setblocking(False)
        nan = [float("nan")] * 21
        flu = mavlink.MAV_FRAME_LOCAL_FLU
        tick = 0
        while True:
            now = self.device_ns()
            try:
                if tick % 20 == 0:
                    self.mavlink.heartbeat_send(mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
                self.mavlink.attitude_quaternion_send(now // 1_000_000, 1, 0, 0, 0, 0, 0, 0)
                self.mavlink.odometry_send(now // 1_000, flu, flu, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, nan, nan)
                try:
                    for message in self.mavlink.parse_buffer(self.link.recv(4096)) or []:
                        if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                            self.mavlink.timesync_send(self.device_ns(), message.ts1)
                except mavlink.MAVError:
                    pass
            except BlockingIOError:
                pass
            tick += 1
            time.sleep(0.05)


def main():
    machine = Machine()
    try:
        attempt(machine)
    finally:
        machine.qemu.kill()
        machine.qemu.wait()


def attempt(machine):
    began = time.monotonic()
    machine.boot()
    print(f"+ booted: {time.monotonic() - began:.1f} s", flush=True)
    Microcontroller().start()
    written = lambda status: status["counts"]["written"]
    status = machine.until("the service records frames of a real driver", 120,
                           lambda s: s["state"] == "recording" and written(s) >= 5 and not s["camera_lost"])
    print(json.dumps(status["camera"]), status["stamp_clock"], flush=True)
    assert status["camera"]["format"] == "yuyv" and status["camera"]["width"] == 640, status["camera"]
    assert status["camera"]["controls"] == {"brightness": 100} and not status["camera"]["refused"], status["camera"]
    assert status["stamp_clock"] in ("start_of_exposure", "end_of_frame"), "the kernel's own stamps"
    status = machine.until("the microcontroller is heard and its clock followed", 30, lambda s: any(
        clock["source"] == "timesync" for port in s["ports"].values() for clock in port.get("clocks", [])))

    bus = "/sys/bus/platform/drivers/vivid"
    machine.ok(f"echo vivid.0 > {bus}/unbind")
    machine.until("a camera that is unplugged is named", 20, lambda s: s["camera_lost"] is not None)
    before = written(machine.status())
    machine.ok(f"echo vivid.0 > {bus}/bind")
    machine.until("and recovers without a restart", 30, lambda s: not s["camera_lost"] and written(s) > before + 2)

    machine.ok("v4l2-ctl -d /dev/robot-camera -c inject_fatal_streaming_error=1")
    before = written(machine.status())
    machine.until("an error of the stream is survived", 30, lambda s: written(s) > before + 2)

    machine.ok("v4l2-ctl -d /dev/robot-camera -c percentage_of_dropped_buffers=100")
    machine.until("a stall is noticed", 20, lambda s: s["camera_lost"] == "stalled")
    machine.ok("v4l2-ctl -d /dev/robot-camera -c percentage_of_dropped_buffers=30")
    before = machine.status()
    status = machine.until("drops are counted", 40, lambda s: s["counts"]["dropped"].get("camera", 0)
                           > before["counts"]["dropped"].get("camera", 0) + 3)
    machine.ok("v4l2-ctl -d /dev/robot-camera -c percentage_of_dropped_buffers=0")
    counts = status["counts"]
    assert counts["captured"] == counts["written"] + sum(counts["dropped"].values()), counts
    restarts = machine.ok("systemctl show -p NRestarts realitysim")
    assert restarts == "NRestarts=0", restarts

    said = machine.ok("journalctl -u realitysim --no-pager -o cat")
    for cause in ("went away", "Input/output error", "is open and sends nothing"):
        assert cause in said, f"{cause}: the fault was not seen:\n{said}"
    session = machine.status()["session"]
    machine.ok("systemctl kill -s KILL realitysim")
    machine.until("killed, it is there again", 40, lambda s: s["session"] != session and written(s) >= 2)
    session = machine.status()["session"]
    asked = time.monotonic()
    machine.ok("systemctl stop realitysim", 30)
    print(f"+ stopped: {time.monotonic() - asked:.1f} s", flush=True)
    names = machine.ok(f"ls {session}")
    assert "metadata.yaml" in names and ".active" not in names, names
    code, text = machine.run(f"realitysim info {session}", 60)
    assert code == 0 and "/odom" in text and "/imu/data" in text, text
    print("+ the session is whole", flush=True)
    print(f"all of it: {time.monotonic() - began:.0f} s")


main()

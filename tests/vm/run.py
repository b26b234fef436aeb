"""Boots the virtual machine of build.sh and tries the service in it: `run.py PROGRAM FOLDER [--short]`.

Exit code 0 only if all of it ran. On the host pymavlink plays the microcontrollers; the machine's own video output shows the walk.
"""
import json
import os
import random
import subprocess
import sys
import time

from machine import Machine, captures, connect, new_data_disk
from walk import Microcontroller, Relay, Walk, ns, recorded

PROGRAM, FOLDER = os.path.realpath(sys.argv[1]), os.path.realpath(sys.argv[2])
SHORT = "--short" in sys.argv[3:]
CAPTURES = "/var/lib/realitysim/captures"
BEGAN = time.monotonic()


def main():
    scene = os.path.join(os.path.dirname(os.path.realpath(__file__)), "scene.toml")
    log = os.path.join(FOLDER, "walk.mcap")
    subprocess.run([PROGRAM, "scene", "render", scene, "-o", log], check=True, stdout=subprocess.DEVNULL)
    walk = Walk(log)
    walk.write_disk(os.path.join(FOLDER, "frames.raw"))
    new_data_disk(FOLDER)

    robot = Robot(walk)
    try:
        starts_with_the_machine(robot)
        survives_its_camera(robot)
        survives_a_usb_port(robot)
        survives_a_clock_that_jumps(robot)
        shows_its_captures_to_whoever_fetches_them(robot)
        takes_every_raw_format_and_names_what_it_cannot_have(robot)
        session = tags_a_walk(robot)
        plays_the_walk_to_itself(robot, session)
        survives_a_hang_and_a_kill(robot)
        survives_a_full_disk(robot)
        answers_while_its_disk_hangs(robot)
        robot.machine.ok("sync")
        robot.switch_off()
        judge_the_walk(walk, session)
        for _ in range(1 if SHORT else 5):
            robot.switch_on()
            keeps_what_the_disk_confirmed_through_a_power_cut(robot)
        robot.switch_on()
        has_repaired_itself(robot)
        if not SHORT:
            comes_and_goes_as_a_package(robot)
    finally:
        robot.switch_off()
    print(f"all of it: {time.monotonic() - BEGAN:.0f} s")


class Robot:
    """The machine and what is plugged into it."""

    def __init__(self, walk):
        self.walk = walk
        self.machine = self.board = None
        self.switch_on()

    def switch_on(self):
        began = time.monotonic()
        self.machine = Machine(FOLDER)
        self.board = self.plug("s1.sock")
        print(f"+ booted: {time.monotonic() - began:.1f} s", flush=True)

    def plug(self, name):
        board = Microcontroller(connect(os.path.join(FOLDER, name)), self.walk)
        board.start()
        return board

    def switch_off(self):
        if self.machine:
            self.machine.cut_power()
            self.board.stop()
            self.machine = None


def written(status):
    return status["counts"]["written"]


def is_recording(status):
    return status["state"] == "recording" and written(status) >= 3 and not status["camera_lost"]


# ---------------------------------------------------------------- what is tried


def starts_with_the_machine(robot):
    machine = robot.machine
    status = machine.until("the service records frames of a real driver", 120, is_recording)
    print(" ", json.dumps(status["camera"]), status["stamp_clock"], flush=True)
    assert status["camera"]["format"] == "yuyv" and status["camera"]["width"] == 640, status["camera"]
    assert status["camera"]["controls"] == {"brightness": 100} and not status["camera"]["refused"], status["camera"]
    assert status["stamp_clock"] in ("start_of_exposure", "end_of_frame"), "the kernel's own stamps"
    machine.until("the microcontroller is heard and its clock followed", 60, lambda s: any(
        clock["source"] == "timesync" for port in s["ports"].values() for clock in port.get("clocks", [])))


def survives_its_camera(robot):
    machine = robot.machine
    bus = "/sys/bus/platform/drivers/vivid"
    machine.ok(f"echo vivid.0 > {bus}/unbind")
    machine.until("a camera that is unplugged is named", 60, lambda s: s["camera_lost"] is not None)
    before = written(machine.status())
    machine.ok(f"echo vivid.0 > {bus}/bind")
    machine.until("and recovers without a restart", 60, lambda s: not s["camera_lost"] and written(s) > before + 2)
    brightness = machine.ok("v4l2-ctl -d /dev/robot-camera -C brightness")
    assert brightness == "brightness: 100", f"the driver's reset is undone: {brightness}"

    # Plugged in elsewhere it gets another number; the rules keep its name.
    machine.ok(f"echo vivid.0 > {bus}/unbind")
    machine.until("unplugged once more", 60, lambda s: s["camera_lost"] is not None)
    machine.ok("modprobe -r vivid && modprobe vivid vid_cap_nr=7 vid_out_nr=1 && udevadm settle", 30)
    assert machine.ok("readlink /dev/robot-camera") == "video7"
    before = written(machine.status())
    machine.until("it comes back as another node", 60, lambda s: not s["camera_lost"] and written(s) > before + 2)

    machine.ok("v4l2-ctl -d /dev/robot-camera -c inject_fatal_streaming_error=1")
    before = written(machine.status())
    machine.until("an error of the stream is survived", 60, lambda s: written(s) > before + 2)

    machine.ok("v4l2-ctl -d /dev/robot-camera -c percentage_of_dropped_buffers=100")
    machine.until("a stall is noticed", 60, lambda s: s["camera_lost"] == "stalled")
    machine.ok("v4l2-ctl -d /dev/robot-camera -c percentage_of_dropped_buffers=30")
    dropped = lambda status: status["counts"]["dropped"].get("camera", 0)
    before = dropped(machine.status())
    status = machine.until("drops are counted", 60, lambda s: dropped(s) > before + 3)
    machine.ok("v4l2-ctl -d /dev/robot-camera -c percentage_of_dropped_buffers=0")
    counts = status["counts"]
    accounted = counts["written"] + counts["thinned"] + sum(counts["dropped"].values())
    assert counts["captured"] == accounted + status["recorder"]["frames_waiting"], status
    restarts = machine.ok("systemctl show -p NRestarts realitysim")
    assert restarts == "NRestarts=0", restarts
    said = machine.journal()
    for cause in ("went away", "Input/output error", "is open and sends nothing"):
        assert cause in said, f"{cause}: the fault was not seen:\n{said}"


def survives_a_usb_port(robot):
    machine = robot.machine
    port = lambda status: status["ports"].get("/dev/ttyUSB0", {})
    for what in ("a microcontroller is plugged into USB", "and again"):
        board = robot.plug("usb.sock")
        machine.until(what, 30, lambda s: not port(s).get("closed") and port(s).get("used", {}).get("ODOMETRY", 0) > 5)
        timer_ms = machine.ok("cat /sys/bus/usb-serial/devices/ttyUSB0/latency_timer")
        assert timer_ms == "1", f"the driver holds bytes back for {timer_ms} ms"
        board.stop()
        status = machine.until("unplugged, it is named", 60, lambda s: port(s).get("closed"))
        print(" ", port(status)["closed"], flush=True)


def survives_a_clock_that_jumps(robot):
    """Somebody sets the robot's clock while it records: stamps, and the microcontroller's clock against them, go on."""
    machine = robot.machine
    offsets = lambda status: {(device, clock["system"], clock["base"]): clock["offset_ns"]
                              for device, port in status["ports"].items() for clock in port.get("clocks", [])}
    before = machine.status()
    for jump in ("+3 hours", "-8 hours"):
        machine.ok(f"date -s 'now {jump}' > /dev/null")
        now = machine.status()
        status = machine.until(f"the clock is set {jump}, and it records on", 20, lambda s: written(s) > written(now) + 3)
        assert status["session"] == before["session"] and not status["camera_lost"], status
        off_ms = [abs(offset - offsets(before)[sender]) / 1e6 for sender, offset in offsets(status).items()
                  if sender in offsets(before)]
        assert off_ms and max(off_ms) < 200, off_ms
    machine.ok("date -s 'now +5 hours' > /dev/null")
    restarts = machine.ok("systemctl show -p NRestarts realitysim")
    assert restarts == "NRestarts=0", restarts


def shows_its_captures_to_whoever_fetches_them(robot):
    """A user of the service's group reads captures and writes acknowledgements; another does neither."""
    machine = robot.machine
    session = machine.status()["session"]
    machine.ok("useradd -M -G realitysim fetcher; useradd -M stranger")
    # A segment that is being recorded may get its final name between two commands, or between the list of files and reading them.
    once = f"cat {session}/*.mcap* 2>/dev/null | head -c 100 | grep -q ."
    reads = f"{{ {once} || {{ sleep 1; {once}; }}; }}"
    machine.ok(f"runuser -u fetcher -- sh -c '{reads} && echo yes > {session}/ack/a.jsonl'")
    code, _ = machine.run(f"runuser -u stranger -- sh -c '{reads}'")
    assert code != 0, "captures are for the group only"
    machine.ok(f"rm {session}/ack/a.jsonl")
    print("+ the group reads captures and acknowledges them, others do not", flush=True)


def says(machine, command, words, seconds=60):
    """Runs a recorder until it has said so, however busy the machine is."""
    said = f'grep -qF -e "{words}" /run/said.log'
    code, _ = machine.run(
        f"(cd /tmp; exec timeout --foreground {seconds} {command}) > /dev/null 2> /run/said.log & "
        f"while kill -0 $! 2> /dev/null && ! {said}; do sleep 0.2; done; kill $! 2> /dev/null; wait $!; {said}", seconds + 30)
    assert code == 0, f"{words}: " + machine.run("cat /run/said.log")[1]


def takes_every_raw_format_and_names_what_it_cannot_have(robot):
    machine = robot.machine
    machine.ok("sed '/^republish/d; /^ports/d' /etc/realitysim/robot.toml > /run/formats.toml; chmod 644 /run/formats.toml")
    record = "realitysim record --config /run/formats.toml -o /run/formats --socket /run/formats.sock --json"
    before = machine.status()
    says(machine, record, "another program streams from it")
    machine.until("a second recorder is told that the camera is taken, the first records on", 60,
                  lambda s: written(s) > written(before) + 3 and s["session"] == before["session"])
    machine.ok("systemctl stop realitysim", 30)
    for wanted in ("YUYV", "NV12", "GREY", "RGGB", "BA81", "GBRG", "GRBG"):
        machine.ok(f"{record} --set capture.format={wanted} > /run/formats.out 2> /run/formats.log & echo $! > /run/formats.pid")
        machine.until(f"{wanted} is recorded", 60, lambda s: s["counts"]["captured"] > 10 and written(s) > 2,
                      "--socket /run/formats.sock")
        code, text = machine.run("kill -INT $(cat /run/formats.pid); wait $(cat /run/formats.pid); code=$?;"
                                 " cat /run/formats.out; (exit $code)", 60)
        assert code == 0, f"{code}: {text}\n" + machine.run("cat /run/formats.log")[1]
        status = json.loads(text.splitlines()[-1])
        assert status["camera"]["card"] == "vivid", status
        print(f"  {wanted}: {status['camera']['format']}, {written(status)} frames", flush=True)
    for options, said in (("--set capture.format=MJPG", "has no MJPG of 640 x 480, the size of its lens file; it offers YUYV"),
                          ("--set capture.controls={brightness=100000}", "brightness"),
                          ("--set capture.device=/dev/video99", "no such camera; present are /dev/video")):
        says(machine, f"{record} {options}", said)
    elsewhere = record.replace("/run/formats ", "/tmp/formats ").replace("/run/formats.sock", "/tmp/f.sock")
    says(machine, f"runuser -u nobody -- {elsewhere}", "no permission: your user must be in the group video")
    machine.ok("rm -r /run/formats; systemctl start realitysim", 60)
    machine.until("every raw format of the driver is taken, what it lacks is named", 60, is_recording)


def tags_a_walk(robot):
    """The session's name. The frames of the walk come over vivid's output and a second input of its capture side."""
    machine, board = robot.machine, robot.board
    session = machine.status()["session"]
    machine.ok("systemctl stop realitysim", 30)
    names = machine.ok(f"ls {session}")
    assert "metadata.yaml" in names and ".active" not in names, names
    code, text = machine.run(f"realitysim log info {session}", 120)
    assert code == 0 and "/odom" in text and "/imu/data" in text, text
    print("+ a stopped session is whole", flush=True)

    machine.ok("v4l2-ctl -d /dev/robot-camera -i 1")
    for node in ("/dev/robot-camera", "/dev/video1"):
        machine.ok(f"v4l2-ctl -d {node} --set-dv-bt-timings index=0")
    machine.ok("v4l2-ctl -d /dev/robot-camera -c loop_video=1,osd_text_mode=2")
    machine.ok("mkdir -p /run/systemd/system/realitysim.service.d; "
               "sed -n 's/^ExecStart=.*/[Service]\\nExecStart=\\n& --initial=-2.0,0.1,9.5/p' "
               "/usr/lib/systemd/system/realitysim.service > /run/systemd/system/realitysim.service.d/initial.conf; "
               "systemctl daemon-reload")
    last = len(robot.walk.frames) - 1

    def watch(line):
        if line.startswith("frame "):
            board.number = int(line.split()[1])

    machine.ok(f"rm -f /run/walk; push-frames {last} 30 > /run/steps 2>&1 & echo $! > /run/pusher; sleep 1")
    machine.ok("systemctl start realitysim", 60)
    machine.until("the walk's first frame is recorded", 60, is_recording)
    machine.ok("compare-frames /dev/video10 200 > /run/compared 2>&1 & touch /run/walk")
    # Half-way the camera stalls while the robot walks on, until that is told.
    drops = "v4l2-ctl -d /dev/robot-camera -c percentage_of_dropped_buffers"
    told = """realitysim recorder status --json | tee /run/stalled | grep -q '"camera_lost":"stalled"'"""
    machine.ok(f"(until grep -q 'frame {last // 2}$' /run/steps; do sleep 0.2; done; "
               f"{drops}=100; "
               f"for try in $(seq 40); do sleep 0.5; {told} && break; done; {drops}=0) > /dev/null 2>&1 & echo $!")
    machine.ok("tail -n +1 -f --pid=$(cat /run/pusher) /run/steps", 600, watch)
    # The guest's shell tells of its jobs in between, with their commands, which hold braces too.
    text = machine.ok("cat /run/stalled")
    stalled, _ = json.JSONDecoder().raw_decode(text[text.index('{"'):])
    print("  while no frames came:", stalled["camera_lost"], json.dumps(stalled["last_tag"]), flush=True)
    # tests/live/no_frames.rs tests that the pose is carried on then: here frames wait for seconds on an emulated processor.
    assert stalled["camera_lost"] == "stalled", stalled
    status = machine.until("frames come again", 60, lambda s: not s["camera_lost"])
    print("+ walked:", json.dumps(status["counts"]), json.dumps(status["last_tag"]), flush=True)
    compared = machine.ok("cat /run/compared")
    print("  passed on to /dev/video10:", compared, flush=True)
    came, foreign, _ = (int(word) for word in compared.split(";")[0].split() if word.isdigit())
    # The device gives out the last picture of before first.
    assert came == 200 and foreign <= 2, "frames are passed on bit by bit"
    assert status["counts"]["valid"] >= 10, machine.journal(30)
    machine.ok("rm /run/systemd/system/realitysim.service.d/initial.conf; systemctl daemon-reload")
    return os.path.basename(status["session"])


def plays_the_walk_to_itself(robot, session):
    """To a loopback camera, and out over the UART, from where it comes back over USB: tagged as the first time."""
    machine = robot.machine
    machine.ok("systemctl stop realitysim", 30)
    robot.board.stop()
    relay = Relay(*(connect(os.path.join(FOLDER, name)) for name in ("s1.sock", "usb.sock")))
    relay.start()
    machine.ok("sed 's#^device = .*#device = \"/dev/video10\"#; /^republish/d; /^controls/d; s#{ device = .*mcu[^}]*}, ##' "
               "/etc/realitysim/robot.toml > /run/again.toml; mkdir -p /run/realitysim")
    machine.ok("realitysim record --config /run/again.toml -o /run/again --initial=-2.0,0.1,9.5 > /run/record.log 2>&1 & "
               "echo $! > /run/record")
    # Both names of the rules may point to the USB port now.
    machine.ok(f"realitysim log play {CAPTURES}/{session} --video /dev/video10 --serial /dev/ttyS1 > /run/play.log 2>&1 & echo $! > /run/play")
    used = lambda status: status["ports"].get("/dev/ttyUSB0", {}).get("used", {})
    # An emulated processor tags a few frames a second, most of them beyond its budget.
    status = machine.until("the walk is played to itself", 120, lambda s: s["counts"]["valid"] >= 3 and used(s).get("ODOMETRY", 0) > 50)
    print(" ", status["camera"]["format"], json.dumps(status["counts"]), json.dumps(used(status)), flush=True)
    machine.run("kill -INT $(cat /run/play /run/record) 2>/dev/null; sleep 3; rm -r /run/again", 60)
    relay.stop()
    robot.board = robot.plug("s1.sock")
    machine.ok("systemctl start realitysim", 60)


def survives_a_hang_and_a_kill(robot):
    machine = robot.machine
    # The driver does not change its input while somebody streams.
    machine.ok("systemctl stop realitysim && v4l2-ctl -d /dev/robot-camera -i 0 && systemctl start realitysim", 60)
    machine.until("the webcam again", 60, is_recording)
    for what, order in (("killed, it is there again", "systemctl kill -s KILL realitysim"),
                        ("hung, the watchdog restarts it", "kill -STOP $(systemctl show -P MainPID realitysim)")):
        session = machine.status()["session"]
        machine.ok(order)
        machine.until(what, 60, lambda s: s["session"] != session and is_recording(s))
    assert "watchdog" in machine.ok("journalctl -u realitysim --no-pager -o cat").lower()


def survives_a_full_disk(robot):
    machine = robot.machine
    folder = os.path.dirname(CAPTURES)
    before = machine.status()["session"]
    machine.ok(f"fallocate -l $(($(df --output=avail -B1 {folder} | tail -1) - 6000000)) {folder}/filler")
    stopped = machine.until("a full disk is told", 60, lambda s: (s["recorder"]["stopped"] or {}).get("cause") == "disk_full")
    assert "disk_full" in machine.journal(60), machine.journal(60)
    machine.ok(f"rm {folder}/filler")
    status = machine.until("with room again, it records", 60, lambda s: written(s) > written(stopped) + 2)
    assert status["session"] == before and status["recorder"]["conserved"], status
    code, text = machine.run(f"realitysim log info {before}", 120)
    assert code in (0, 3) and "/odom" in text, f"what was recorded before can be read: {code}\n{text}"


def answers_while_its_disk_hangs(robot):
    """A session cannot end on a disk that takes nothing; whoever asks for it is told so."""
    machine = robot.machine
    folder = os.path.dirname(CAPTURES)
    machine.until("recording", 60, is_recording)
    machine.ok(f"fsfreeze -f {folder}")
    try:
        code, text = machine.run("realitysim recorder stop --json", 40)
        assert code == 3, f"data may be lost: {code}: {text}"
        stopped = next(json.loads(line) for line in text.splitlines() if line.startswith("{"))
        assert stopped["state"] == "stopped" and stopped["unfinished"], stopped
        print("+ a session that cannot end:", stopped["unfinished"], flush=True)
    finally:
        machine.ok(f"fsfreeze -u {folder}")
    machine.ok("realitysim recorder start", 40)
    status = machine.until("with its disk back, it records", 60, is_recording)
    assert status["earlier"]["sessions"] == 1 and status["earlier"]["unfinished"] == 1, status["earlier"]


def keeps_what_the_disk_confirmed_through_a_power_cut(robot):
    """How many seconds are lost is printed and not judged: an emulated machine on a busy host stands still for seconds. That nothing
    grows older than the bound is tested on a disk with a clock of its own (`src/recording/simulation`)."""
    machine, board = robot.machine, robot.board
    session = os.path.basename(machine.until("recording", 120, lambda s: is_recording(s) and any(
        port.get("used", {}).get("ODOMETRY", 0) > 20 for port in s["ports"].values()))["session"])
    time.sleep(random.uniform(2, 6))
    recorder = machine.until("the disk confirms", 60, lambda s: s["recorder"]["frames_synced"] > 20)["recorder"]
    time.sleep(random.uniform(0, 1))
    cut = time.monotonic()
    robot.switch_off()
    folder = os.path.join(captures(FOLDER, "cut"), session)
    kept = recorded(folder, ["/odom", "/camera/image/compressed"])
    counted = [round(message.twist.twist.linear.z) for topic, message in kept if topic == "/odom"]
    frames = len(kept) - len(counted)
    assert counted, "nothing of the session can be read"
    missing = counted[-1] - counted[0] + 1 - len(counted)
    code = subprocess.run([PROGRAM, "log", "info", folder], stdout=subprocess.DEVNULL).returncode
    print(f"+ power cut: {frames} frames can be read, {recorder['frames_synced']} were confirmed a moment before; the last"
          f" {cut - board.sent[max(counted)]:.2f} s are lost (bound without stalls of the host"
          f" {recorder['loss_bound_ms'] / 1e3:.2f})", flush=True)
    assert frames >= recorder["frames_synced"], "frames that the disk had confirmed are gone"
    assert counted == sorted(set(counted)) and missing == 0, "there are holes before the cut"
    assert code in (0, 3), code


def has_repaired_itself(robot):
    """Once the service is there again, what the cuts left is whole for everybody."""
    machine = robot.machine
    machine.until("recording", 120, is_recording)
    machine.ok("systemctl stop realitysim", 30)
    torn = machine.ok(f"find {CAPTURES} -name '*.active'")
    assert not torn, torn
    code, text = machine.run(f"realitysim sessions verify --captures {CAPTURES}", 200)
    assert code == 0, text
    print("+ what the cuts left is whole again", flush=True)


def comes_and_goes_as_a_package(robot):
    """Over the files of `realitysim install`, whose config and captures it keeps. tests/package/check_deb.sh tries the rest."""
    machine = robot.machine
    state = lambda: machine.run("systemctl is-active realitysim")[1]
    sessions = lambda: int(machine.ok(f"ls -d {CAPTURES}/*/ | wc -l"))
    machine.ok("dpkg --install --force-confold /opt/realitysim.deb", 400)
    assert state() == "inactive", "the package starts nothing"
    machine.ok("systemctl start realitysim", 60)
    before = machine.until("the service of the package records", 120, is_recording)["session"]
    machine.ok("dpkg --install --force-confold /opt/realitysim.deb", 400)
    machine.until("an upgrade restarts it", 120, lambda s: s["session"] != before and is_recording(s))
    kept = sessions()
    machine.ok("dpkg --remove realitysim", 200)
    assert state() == "inactive" and machine.run("test -e /usr/bin/realitysim")[0] != 0, state()
    machine.ok("dpkg --purge realitysim; ! test -e /etc/realitysim", 200)
    assert sessions() == kept and machine.ok(f"stat -c %U {CAPTURES}") == "realitysim", "captures outlive the package"
    assert not machine.ok(f"find {CAPTURES} -name '*.active'"), "its last session is whole"
    print("+ installed, upgraded, removed and purged as a package", flush=True)


def judge_the_walk(walk, session):
    folder = os.path.join(captures(FOLDER, "walked"), session)
    frames = [(ns(message.header.stamp), bytes(message.data))
              for _, message in recorded(folder, ["/camera/image/compressed"])]
    truth = os.path.join(FOLDER, "truth.mcap")
    known = walk.write_truth(truth, frames)
    seen = {walk.number.get(data) for _, data in frames} - {None}
    print(f"+ recorded: {len(frames)} frames, {known} of them identical to rendered ones, {len(seen)} of {len(walk.frames)}"
          " different ones", flush=True)
    assert len(seen) >= 0.9 * len(walk.frames), "most frames of the walk are there, bit by bit"
    answer = subprocess.run([PROGRAM, "eval", folder, "--truth", truth, "--json"], stdout=subprocess.PIPE)
    assert answer.returncode in (0, 3), answer
    judged = json.loads(answer.stdout)
    error = judged["position_cm"]
    print(f"  tags: {judged['judged']} judged, {error['mean']:.2f} cm off on average, {error['max']:.2f} cm at most", flush=True)
    assert judged["judged"] >= 20 and error["mean"] < 3 and error["max"] < 15, judged


if __name__ == "__main__":
    main()

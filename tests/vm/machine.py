"""The virtual machine of build.sh: started, spoken to over a serial line, switched off like a robot whose battery fell out."""
import json
import os
import re
import socket
import subprocess
import time

SOCKET = "--socket /run/realitysim/control.sock"
DATA_MB = 900
# An emulated machine on a busy host may stand still for a while, which is no fault of what it runs.
PATIENCE_S = 120


def connect(path, patience=30):
    until = time.monotonic() + patience
    while True:
        link = socket.socket(socket.AF_UNIX)
        try:
            link.connect(path)
            return link
        except OSError:
            link.close()
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


class Machine:
    """One power-on. The captures' disk `data.img` outlives it; the system's disk is as new each time."""

    def __init__(self, folder):
        self.folder = folder
        self.qemu = None
        # On a host that is busy an emulated kernel may panic over its timers before it has begun.
        for attempt in range(3):
            try:
                return self.boot()
            except (ConnectionError, TimeoutError) as error:
                print(f"  it did not boot ({error}), again", flush=True)
                self.cut_power()
        raise SystemExit("the machine did not boot: see console.log")

    def boot(self):
        folder = self.folder
        for name in ("s1.sock", "s2.sock", "usb.sock", "monitor.sock"):
            if os.path.exists(os.path.join(folder, name)):
                os.remove(os.path.join(folder, name))
        subprocess.run(["qemu-img", "create", "-q", "-f", "qcow2", "-b", "root.qcow2", "-F", "qcow2", "now.qcow2"],
                       cwd=folder, check=True)
        disk = lambda name, kind, more="": ["-drive", f"file={name},format={kind},if=virtio{more}"]
        self.qemu = subprocess.Popen(
            ["qemu-system-x86_64", "-M", "pc", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "768",
             "-nodefaults", "-no-reboot", "-display", "none", "-kernel", "vmlinuz", "-initrd", "initrd.gz",
             "-append", "console=ttyS0 quiet panic=-1 mitigations=off no_timer_check unknown_nmi_panic=1",
             "-monitor", "unix:monitor.sock,server=on,wait=off", "-serial", "file:console.log",
             "-chardev", "socket,id=s1,path=s1.sock,server=on,wait=off", "-serial", "chardev:s1",
             "-chardev", "socket,id=s2,path=s2.sock,server=on,wait=off", "-serial", "chardev:s2",
             "-device", "piix3-usb-uhci,id=usb", "-chardev", "socket,id=u1,path=usb.sock,server=on,wait=off",
             "-device", "usb-serial,chardev=u1,bus=usb.0", "-device", "virtio-rng-pci",
             *disk("now.qcow2", "qcow2", ",cache=unsafe"), *disk("data.img", "raw", ",cache=unsafe"),
             *disk("frames.raw", "raw", ",readonly=on")],
            cwd=folder)
        self.shell = connect(os.path.join(folder, "s2.sock"))
        self.text = ""
        self.count = 0
        until = time.monotonic() + 400
        while True:
            self.shell.sendall(b"true\n")
            if self.wait(r"# ?$", 2):
                break
            if time.monotonic() > until:
                raise TimeoutError("no shell")
        self.shell.sendall(b"stty -echo; PS1=\n")
        time.sleep(0.5)
        self.run("true", 60)

    def wait(self, pattern, seconds, watch=None):
        """Text before the pattern, and the match; `watch` gets each whole line meanwhile."""
        until = time.monotonic() + seconds
        self.shell.settimeout(0.2)
        seen = 0
        while time.monotonic() < until:
            while watch and (end := self.text.find("\n", seen)) >= 0:
                watch(self.text[seen:end])
                seen = end + 1
            found = re.search(pattern, self.text, re.MULTILINE)
            if found:
                before, self.text = self.text[:found.start()], self.text[found.end():]
                return before, found
            try:
                data = self.shell.recv(65536)
            except TimeoutError:
                continue
            if not data:
                raise ConnectionError("the machine is off")
            self.text += data.decode(errors="replace").replace("\r", "")
        return None

    def run(self, command, seconds=60, watch=None):
        """Exit code and output."""
        self.count += 1
        mark = f"__M{self.count}_"
        self.text = ""
        self.shell.sendall(f"{command}; echo {mark[:3]}''{mark[3:]}$?_\n".encode())
        pattern = mark + r"(\d+)_\n"
        answer = self.wait(pattern, seconds, watch)
        if not answer:
            print(f"  no answer within {seconds} s to: {command}\n{self.text[-2000:]}", flush=True)
            answer = self.wait(pattern, PATIENCE_S, watch)
            if not answer:
                raise SystemExit(f"nor within {PATIENCE_S} s more; {self.why_it_stands_still()}")
            print("  it answered after all", flush=True)
        before, found = answer
        return int(found.group(1)), before.strip()

    def why_it_stands_still(self):
        """What QEMU's threads did for a second, and the stacks that the kernel prints before it panics of an NMI."""
        ticks = lambda: {thread: sum(map(int, open(f"/proc/{self.qemu.pid}/task/{thread}/stat").read().rsplit(")")[-1].split()[11:13]))
                         for thread in os.listdir(f"/proc/{self.qemu.pid}/task")}
        before = ticks()
        time.sleep(1)
        busy = {thread: now - before.get(thread, 0) for thread, now in ticks().items()}
        with connect(os.path.join(self.folder, "monitor.sock")) as monitor:
            monitor.sendall(b"info cpus\ninfo status\nnmi\n")
            time.sleep(10)
            monitor.settimeout(1)
            try:
                said = monitor.recv(65536).decode(errors="replace")
            except TimeoutError:
                said = "QEMU's monitor says nothing: its main thread waits for a line that nobody reads"
        with open(os.path.join(self.folder, "console.log"), errors="replace") as console:
            return f"hundredths of a second of each thread: {busy}\n{said}\nconsole:\n{console.read()[-6000:]}"

    def ok(self, command, seconds=60, watch=None):
        code, text = self.run(command, seconds, watch)
        assert code == 0, f"{command}: {code}\n{text}"
        return text

    def status(self, socket=SOCKET):
        code, text = self.run(f"realitysim recorder status --json {socket} 2>/dev/null", 60)
        return json.loads(text.splitlines()[-1]) if code == 0 else None

    def until(self, what, seconds, holds, socket=SOCKET):
        """The first status of which it holds."""
        began = time.monotonic()
        status = None
        while time.monotonic() - began < seconds:
            status = self.status(socket)
            if status and holds(status):
                print(f"+ {what}: {time.monotonic() - began:.1f} s", flush=True)
                return status
            time.sleep(0.2)
        raise SystemExit(f"- {what}: not within {seconds} s; {json.dumps(status)}\n" + self.journal(40))

    def journal(self, lines=1000):
        return self.run(f"journalctl -u realitysim -n {lines} --no-pager -o cat")[1]

    def cut_power(self):
        """Nothing that the machine has not sent to its disk is on it. (What it has sent outlives it, whether the host's disk has it
        or not: so that disk is not waited for.)"""
        self.qemu.kill()
        self.qemu.wait()


def new_data_disk(folder):
    path = os.path.join(folder, "data.img")
    if os.path.exists(path):
        os.remove(path)
    subprocess.run(["mke2fs", "-q", "-t", "ext4", path, f"{DATA_MB}M"], check=True)


def captures(folder, name):
    """A copy of what lies on the captures' disk, its journal recovered as the next boot would."""
    image, out = os.path.join(folder, "look.img"), os.path.join(folder, name)
    subprocess.run(["cp", "--sparse=always", os.path.join(folder, "data.img"), image], check=True)
    code = subprocess.run(["e2fsck", "-fy", image], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
    assert code in (0, 1), f"e2fsck: {code}"
    subprocess.run(["rm", "-rf", out], check=True)
    os.mkdir(out)
    subprocess.run(["debugfs", "-R", f"rdump captures {out}", image], check=True, stderr=subprocess.DEVNULL)
    os.remove(image)
    return os.path.join(out, "captures")

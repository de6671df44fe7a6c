"""The stage driver against GRBL's and grblHAL's own code, compiled for this computer.

grbl_firmware.py RIG SIMULATOR [ARGUMENT…]

SIMULATOR is grbl-sim's or grblHAL's simulator with limit switches (README.md says
how to make them). It speaks on a pseudo-terminal that this script opens, and every
step below is a `rig` command as an operator would give it. Every check is one
line; the last line is their number.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty

checks = 0
SETTINGS = (
    # Homing to the lower ends, soft limits, 20 steps per degree, no pauses.
    ["$22=1", "$20=1", "$23=7", "$24=300", "$25=3000", "$27=1", "$30=1000", "$32=0"]
    + [f"$10{axis}=20" for axis in range(3)]
    + [f"$11{axis}=6000" for axis in range(3)]
    + [f"$12{axis}=300" for axis in range(3)]
    + ["$130=340", "$131=73", "$132=50"]
)
RIG_FILE = """
[rig]
name = "firmware"
[camera]
driver = "command"
command = "python3 {photo} {{exposure_s}} {{output}}"
resolution_px = [16, 12]
bit_depth = 12
shortest_ms = 0.1
longest_ms = 1000.0
[stage]
driver = "grbl"
port = "{port}"
feed_per_min = 3000.0
approach_deg = 2.0
reply_timeout_s = 10.0
connect_timeout_s = 10.0
position_tolerance_deg = 0.06
lamp_off = "M5; M9"
[stage.azimuth]
axis = "X"
offset_deg = 170.0
min_deg = -168.0
max_deg = 169.0
[stage.elevation]
axis = "Y"
offset_deg = 88.0
min_deg = 20.0
max_deg = 87.0
[[stage.lamp]]
measures = "R"
on = "M3 S1000"
[[stage.lamp]]
measures = "G"
on = "M8"
[[stage.lamp]]
measures = "B"
on = "M3 S500"
[geometry.camera]
model = "orthographic"
extent_mm = [29.3, 22.0]
position_mm = [0.0, 0.0, 110.0]
look_at_mm = [0.0, 0.0, 0.0]
up = [0.0, 1.0, 0.0]
[geometry.sample]
shape = {{ kind = "bowl", radius_mm = 10.0, segments = 32 }}
[geometry.sample_from_stage]
rotation_deg = [0.0, 0.0, 0.0]
translation_mm = [0.0, 0.0, 0.0]
"""


def check(name, is_so, shown=""):
    global checks
    if not is_so:
        sys.exit(f"FAILED: {name} {shown}")
    checks += 1
    print(f"ok {name}", flush=True)


class Firmware:
    """The simulator behind a pseudo-terminal, and all that it and `rig` say."""

    def __init__(self, command, folder):
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        # Kept open, so that the terminal outlives each command's use of it.
        self.slave = slave
        self.said = bytearray()
        # Its existence is the light that the camera sees.
        self.light = os.path.join(folder, "light")
        self.console, console_slave = os.openpty()
        tty.setraw(console_slave)
        self.process = subprocess.Popen(
            command, cwd=folder, stdin=console_slave, stdout=console_slave
        )
        threading.Thread(target=self.towards, daemon=True).start()
        threading.Thread(target=self.back, daemon=True).start()

    def towards(self):
        line = b""
        while data := os.read(self.master, 4096):
            *lines, line = (line + data).split(b"\n")
            for command in lines:
                if command.startswith((b"M3", b"M8")):
                    open(self.light, "w").close()
                elif command.startswith((b"M5", b"M9")) and os.path.exists(self.light):
                    os.remove(self.light)
            os.write(self.console, data)

    def back(self):
        while data := os.read(self.console, 4096):
            self.said += data
            os.write(self.master, data)

    def ask(self, line, until=b"ok"):
        """Over the cable itself, while no program has the port open."""
        start = len(self.said)
        os.write(self.console, line)
        return self.hear(start, until, line)

    def hear(self, start, until, asked="nothing"):
        for _ in range(600):
            time.sleep(0.05)
            if until in self.said[start:]:
                return bytes(self.said[start:]).decode(errors="replace")
        sys.exit(f"FAILED: the simulator did not answer {asked!r}: {self.said[start:]!r}")

    def outputs(self):
        """The outputs by GRBL's own reports: those after `A:`, which not all have."""
        found = None
        for _ in range(25):
            report = self.ask(b"?", b">")
            if "|Ov:" in report:
                found = report.split("|A:")[1].split("|")[0].rstrip(">\r\n") if "|A:" in report else ""
        return found


def main(rig, simulator):
    folder = tempfile.mkdtemp(prefix="rig-firmware-")
    firmware = Firmware(simulator, folder)
    firmware.hear(0, b"help]")
    time.sleep(2.0)
    for setting in SETTINGS:
        firmware.ask(setting.encode() + b"\n")
    firmware.ask(b"\x18", b"Grbl")
    # The commands are to read what they get themselves.
    termios_flush(firmware)
    rig_file = os.path.join(folder, "rig.toml")
    photo = os.path.join(folder, "photo.py")
    with open(photo, "w") as file:
        file.write(PHOTO)
    record = os.path.join(os.path.dirname(__file__), "../vm/calibration/vm/sensor/20261121T020000Z-sensor.toml")
    sensors = os.path.join(folder, "calibration/firmware/sensor")
    os.makedirs(sensors)
    with open(record) as file, open(os.path.join(sensors, os.path.basename(record)), "w") as copy:
        text = file.read().replace('rig = "vm"', 'rig = "firmware"').replace("[128, 96]", "[16, 12]")
        copy.write(re.sub("device_serial = .*", 'device_serial = ""', text))
    with open(rig_file, "w") as file:
        file.write(RIG_FILE.format(port=firmware.port, photo=photo))

    def run(*arguments, after=None, how=signal.SIGINT):
        process = subprocess.Popen(
            [rig, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        if after is not None:
            time.sleep(after)
            process.send_signal(how)
        out, err = process.communicate(timeout=300)
        return process.returncode, out, err

    def stage(*arguments, **more):
        return run("stage", *arguments, "--rig", rig_file, **more)

    code, out, err = stage("status", "--json")
    check("a controller just started is recognised", code == 0, err)
    status = json.loads(out)
    print("  ", json.dumps(status))
    check("its version is read", status["stage"]["firmware"].startswith("1.1"), out)
    check("its lamp is off", "off" in json.dumps(status).lower(), out)

    code, out, err = stage("move", "--azimuth", "20", "--elevation", "60", "--json")
    check("it homes and moves", code == 0, err)
    print("  ", " ".join(out.split()))
    position = firmware.ask(b"?", b">")
    check("the firmware says that it stands there", "-150.000,-28.000" in position, position)

    begin = time.monotonic()
    code, out, err = stage("move", "--azimuth", "20", "--elevation", "89")
    check("an angle out of reach is refused", code == 1 and "89" in err, err)

    for channel, expected in [("0", "S"), ("1", "F")]:
        code, out, err = stage("lamp", channel, "--home", "--seconds", "1")
        check(f"lamp {channel} lights and goes out", code == 0, err)
        check(f"channel {channel} was reported by the firmware", f"|A:{expected}".encode() in firmware.said, out)
        check("nothing is on afterwards", firmware.outputs() in ("", None))

    code, out, err = stage("lamp", "0", "--home", after=12.0)
    check("Ctrl-C turns the lamp off", code == 130 and firmware.outputs() in ("", None), (code, err))

    code, out, err = stage("lamp", "0", "--home", after=12.0, how=signal.SIGKILL)
    time.sleep(3.0)
    check("so does the guardian of a killed program", firmware.outputs() in ("", None), (code, err))

    code, out, err = stage("move", "--azimuth", "150", "--elevation", "60", after=9.0)
    check("Ctrl-C ends a move", code == 130, (code, err))
    places = []
    for _ in range(2):
        report = firmware.ask(b"?", b">")
        places.append(re.search("<(Idle|Alarm).*MPos:([^|]*)", report))
        time.sleep(0.5)
    check("the stage stands", all(places) and places[0][2] == places[1][2], report)
    check("somewhere on its way", not places[0][2].startswith(("-20.000", "-339.000")), report)

    code, out, err = run("capture", "--rig", rig_file, "--lights", "2", "--sample", "grey", "--no-fit")
    print("  ", " ".join(err.split())[-300:])
    check("a capture of two lights ends", code == 0, err)
    check("and leaves the lamp off", firmware.outputs() in ("", None))
    firmware.process.kill()
    print(checks, "checks pass")


def termios_flush(firmware):
    import termios

    time.sleep(0.5)
    termios.tcflush(firmware.slave, termios.TCIFLUSH)


# A grey sample on an 12-bit camera without noise: counts go with the exposure.
PHOTO = '''
import os, sys, struct, zlib
exposure_s, path = float(sys.argv[1]), sys.argv[2]
light = os.path.exists(os.path.join(os.path.dirname(os.path.abspath(__file__)), "light"))
width, height = 16, 12
rows = b""
for y in range(height):
    values = [min(4050, int(64 + light * 2e5 * exposure_s * (0.2 + 0.8 * x / width))) for x in range(width)]
    rows += b"\\0" + struct.pack(f">{width}H", *values)
def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
with open(path, "wb") as file:
    file.write(b"\\x89PNG\\r\\n\\x1a\\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))
'''

if __name__ == "__main__":
    main(os.path.abspath(sys.argv[1]), [os.path.abspath(sys.argv[2]), *sys.argv[3:]])

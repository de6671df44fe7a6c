"""The simulated Zaber devices asked by Zaber's own client.

zaber_client.py ZABER_PORT_BINARY

Every check is one line; the last line is their number. Nothing here needs the
network: the devices are not looked up in Zaber's database, so positions are in
microsteps.
"""

import subprocess
import sys
import time

from zaber_motion import CommandFailedException
from zaber_motion.ascii import Connection, WarningFlags

checks = 0


def check(name, is_so, shown=""):
    global checks
    if not is_so:
        sys.exit(f"FAILED: {name} {shown}")
    checks += 1
    print(f"ok {name}")


def main(port, checksums):
    with Connection.open_serial_port(port) as connection:
        connection.checksum_enabled = checksums
        connection.generic_command("set comm.checksum 1" if checksums else "set comm.checksum 0")
        devices = connection.detect_devices(identify_devices=False)
        check("two devices are detected", [d.device_address for d in devices] == [1, 2], devices)
        controller, illuminator = devices
        axes = [controller.get_axis(1), controller.get_axis(2)]
        controller.generic_command("system reset")
        time.sleep(0.1)
        flags = axes[0].warnings.get_flags()
        check("an axis that was not homed says so", flags == {WarningFlags.NO_REFERENCE_POSITION}, flags)
        reply = controller.generic_command("get version")
        check("the version is read", reply.data == "7.38", reply.data)
        for axis in axes:
            axis.generic_command("home")
        for axis in axes:
            axis.wait_until_idle()
        check("homed axes have no warnings", all(not a.warnings.get_flags() for a in axes))
        replies = [axis.generic_command("get pos").data for axis in axes]
        check("homed axes are at 0", replies == ["0", "0"], replies)
        begin = time.monotonic()
        axes[0].generic_command("move abs 20000")
        check("a moving axis is busy", axes[0].is_busy())
        check("the other one is not", not axes[1].is_busy())
        axes[0].wait_until_idle()
        took_s = time.monotonic() - begin
        # 20 units at 50 units/s and 200 units/s²: 0.65 s.
        check("the move takes its time", 0.55 < took_s < 5.0, took_s)
        check("it arrives", axes[0].generic_command("get pos").data == "20000")
        axes[1].generic_command("move abs 80000")
        axes[1].generic_command("stop")
        flags = axes[1].warnings.get_flags()
        check("a stopped axis is idle", not axes[1].is_busy())
        check("an interrupted move is noted", WarningFlags.MOVEMENT_INTERRUPTED in flags, flags)
        axes[1].generic_command("move abs 80000")
        axes[1].stop()
        check("the client's own stop ends a move", not axes[1].is_busy())
        for command, reason in [
            ("move abs -1", "BADDATA"),
            ("dance", "BADCOMMAND"),
        ]:
            try:
                axes[0].generic_command(command)
                check(f"{command} is rejected", False)
            except CommandFailedException as error:
                words = error.details.response_data
                check(f"{command} is rejected with {reason}", words == reason, words)
        controller.generic_command("io set do 2 1")
        check("outputs read back", controller.generic_command("io get do").data == "0 1 0 0")
        lamp = illuminator.get_axis(1)
        lamp.generic_command("lamp on")
        check("a lamp reads back as on", lamp.generic_command("get lamp.status").data == "2")
        lamp.generic_command("lamp off")
        check("a lamp reads back as off", lamp.generic_command("get lamp.status").data == "1")
        responses = connection.generic_command_multi_response("get system.serial")
        check("both devices answer a broadcast", [r.data for r in responses] == ["60001", "60002"])


with subprocess.Popen([sys.argv[1]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as simulator:
    try:
        path = simulator.stdout.readline().strip()
        for checksums in [False, True]:
            print(f"with{'' if checksums else 'out'} checksums")
            main(path, checksums)
    finally:
        simulator.stdin.close()
print(f"{checks} checks passed")

//! Advice on stages and cameras.

use crate::device::retake::FrameFault;
use crate::device::{
    AlarmCause, AnswerFault, DeviceError, FirmwareFault, ProgramFault, Speaker, WebcamFault,
};

pub(super) fn for_device(error: &DeviceError) -> String {
    use DeviceError::*;
    let hint = match error {
        // Opening the device.
        NotFound { device } if device.starts_with("/dev/") => {
            "run `rig devices` to see what is connected; name ports by /dev/serial/by-id, which survives replugging"
        }
        NotFound { .. } => {
            "check the path in the rig file or on the command line: nothing of that name is there (`rig devices` lists what is connected)"
        }
        OnNetwork { device } => {
            let address = device.split_once("://").map_or(&**device, |(_, rest)| rest);
            let number = if address.contains(':') { "" } else { ":PORT" };
            return format!(
                "socat makes a port of it: `socat pty,raw,echo=0,link=$HOME/stage tcp:{address}{number}`, then port = that link's path; a cable is safer, because a network that fails leaves the lamp as it was"
            );
        }
        PermissionDenied { device } if device.starts_with("/dev/") => {
            "`rig devices` shows which users may open it: where that is a group, add yourself to it (`sudo usermod -aG dialout,video $USER`), then log in again"
        }
        PermissionDenied { .. } => "check who owns the file and its folder, and their permissions",
        Busy { device } => {
            return format!(
                "`fuser -v {device}` names the process that holds it; end that one first"
            );
        }
        Claimed { .. } => {
            "desktops claim cameras to show their files: `gio mount -s gphoto2` lets go of it, and `systemctl --user mask --now gvfs-gphoto2-volume-monitor` keeps it so; else end the other program (`lsof /dev/bus/usb/*/*` lists them)"
        }
        Controlled { .. } => {
            "end the other program that has the camera, on this machine or another one; after a crash the camera is free again within its heartbeat time-out, mostly 3 s"
        }
        NoReply { .. } => {
            "check power and cable, and that driver and baud rate are this device's; `rig devices` shows whether it is still there; a slow camera needs a longer camera.frame_timeout_s"
        }
        Garbled { .. } => {
            "check the baud rate, and that the port belongs to this device (`rig devices`)"
        }
        // Its kind, firmware and program.
        WrongKind { .. } => "name another: `rig devices` lists the cameras and serial ports",
        OtherProtocol { speaks, .. } => for_firmware_family(*speaks),
        Firmware { fault, .. } => for_firmware(fault),
        Program { program, fault } => return for_program(program, fault),
        Answer { fault, .. } => for_answer(fault),
        OtherCamera { .. } => {
            "connect the camera of that serial number; where the other one is meant, name it in camera.serial of the rig file and calibrate it (`rig calibrate sensor`), because records belong to one camera"
        }
        NoImages { .. } => {
            "name the first node of the camera, whose name ends in index0: `rig devices` lists it"
        }
        Compressed { .. } => {
            "raw counts need an uncompressed format: take another camera, or one whose own program writes raw frames (camera.driver = \"command\" or \"folder\")"
        }
        Webcam { device, fault } => return for_webcam(device, fault),
        NoBandwidth { .. } => {
            "plug it into a port of another USB controller, without a hub, and end the streams of other cameras; one that asks for more than it needs is cured by `sudo rmmod uvcvideo && sudo modprobe uvcvideo quirks=128`"
        }
        BadFrame { fault, .. } => for_frame(fault),
        WithoutDriver => {
            "build it with `cargo build --locked --release --features genicam,webcam`, or take the Debian package"
        }
        // Its answers to commands.
        Refused { .. } => {
            "check the rig file against what the device accepts: `rig stage status`, `rig camera info` and `rig camera controls` show that"
        }
        Alarm { cause, .. } => for_alarm(*cause),
        NotHomed { .. } => "run `rig stage home` first",
        OutOfReach { .. } => {
            "choose fewer or other lights, or correct the limits in the rig file's [stage] table"
        }
        NotApplied { .. } => {
            "the device has another range or step; `rig camera info` and `rig stage status` show what it accepts"
        }
        // Failures while it works.
        Disconnected { .. } => {
            "check the cable and the USB hub's power, then `rig doctor`; an interrupted capture continues with `rig capture --resume`"
        }
        TemporaryFolder { .. } => {
            "the variable TMPDIR names that folder (without it, it is /tmp): name one that exists and can be written"
        }
        Relieved { .. } => {
            "find out what stopped the program or kept it from running (`kill -STOP`, a debugger, too little memory): its guardian reports whether the lamp went off; Ctrl-Z pauses a capture, and an interrupted one continues with `rig capture --resume`"
        }
        Unguarded { .. } => {
            "leave the process `rig guardian` alone, which turns the lamp off where this program cannot; an interrupted capture continues with `rig capture --resume`"
        }
        Io { .. } => {
            "see what the kernel reports (`dmesg`), and whether it is the device that the rig file names; `rig doctor` checks that"
        }
    };
    hint.to_owned()
}

fn for_webcam(device: &str, fault: &WebcamFault) -> String {
    match fault {
        WebcamFault::NoFormat {
            width, height, ..
        } => format!(
            "`v4l2-ctl -d {device} --list-formats-ext` lists what the camera has: resolution_px must be there under YUYV, and a camera that is set to another format is set to this one by `v4l2-ctl -d {device} --set-fmt-video=width={width},height={height},pixelformat=YUYV`; camera.driver = \"v4l\" reads more formats"
        ),
        WebcamFault::DamageUnseen { .. } => {
            "take camera.driver = \"v4l\", which sees the mark of damaged frames, or let the kernel discard them: `echo 0 | sudo tee /sys/module/uvcvideo/parameters/nodrop`, then plug the camera in anew".to_owned()
        }
    }
}

fn for_firmware_family(speaks: Speaker) -> &'static str {
    match speaks {
        Speaker::Grbl => {
            "name it as what it is: driver = \"grbl\" in the rig file's [stage] table, or --driver grbl"
        }
        Speaker::Zaber => {
            "name it as what it is: driver = \"zaber\" in the rig file's [stage] table, or --driver zaber"
        }
        Speaker::Marlin
        | Speaker::Klipper
        | Speaker::RepRap
        | Speaker::Smoothie
        | Speaker::TinyG => {
            "this firmware is not supported: put GRBL 1.1, grblHAL or FluidNC on the board, or take another port (`rig devices`)"
        }
    }
}

/// Settings are GRBL's.
fn for_firmware(fault: &FirmwareFault) -> &'static str {
    use FirmwareFault::*;
    match fault {
        Old { is, .. } if is.starts_with("Zaber") => {
            "update the firmware of the device with Zaber Launcher"
        }
        Old { .. } => {
            "put GRBL 1.1 (https://github.com/gnea/grbl) or grblHAL on the board: older versions don't report outputs and causes of alarms"
        }
        HomingDisabled { .. } => {
            "fit limit switches to the axes, then set $22=1 and the homing settings $23 to $27 (grblHAL: the axes in $44 and on, too)"
        }
        NothingToHome { .. } => {
            "give the axes a homing cycle: of grblHAL in $44 and on, of FluidNC under `homing:` of each axis in its configuration file"
        }
        LaserMode(_) => {
            "set $32=0, so that the lamp stays as it was switched while the stage moves and stands"
        }
        Inches(_) => "set $13=0, so that positions are reported in millimetres (or degrees)",
        NoPosition => "set $10=1, so that status reports have machine positions",
        NoAxis { .. } => {
            "name axes that the controller has: `axis` in [stage.azimuth] and [stage.elevation] of the rig file"
        }
        Door(_) => {
            "close the safety door, then `rig stage home`; where no door switch is fitted, the input floats or is inverted: tie it to its idle level, or disable it in the firmware"
        }
        Held(_) => "see why it was held, then `rig stage home`, which resets it",
        Asleep => "`rig stage home` resets it and wakes it",
        Configuration(_) => {
            "correct the controller's configuration file (FluidNC: `$SS` shows its messages at start-up), then restart it"
        }
        Undervoltage(_) => {
            "see to its power supply: a USB hub without power of its own, a thin or long cable, a motor or lamp on the controller's own supply; then `rig stage status`"
        }
        Restarting(_) => {
            "its firmware fails or is not that of this board: write GRBL 1.1, grblHAL or FluidNC for this board anew; `rig stage status` shows whether it answers"
        }
        Unsupported { .. } => {
            "take commands in the rig file that this firmware has, or build it with these: M7 of GRBL needs ENABLE_M7 in its config.h"
        }
    }
}

fn for_alarm(cause: AlarmCause) -> &'static str {
    match cause {
        AlarmCause::LimitSwitch => {
            "find out what the stage hit, move it off the switch by hand with its motors unpowered, then `rig stage home`"
        }
        AlarmCause::SoftLimit => {
            "the limits in the rig file's [stage] table go beyond the travel that the controller knows ($130 to $132 from its zero): correct whichever is wrong, then `rig stage home`"
        }
        AlarmCause::Homing => {
            "check that each limit switch opens and closes, its polarity ($5), the direction of the search ($23), the travel ($130 to $132) and the pull-off ($27), then `rig stage home`"
        }
        AlarmCause::EmergencyStop => {
            "release the emergency stop, or what else closes an input, then `rig stage home`"
        }
        AlarmCause::HomingRequired => {
            "make sure that the stage is free to move, then `rig stage home`"
        }
        AlarmCause::Other => "find out what the stage hit or lost, then `rig stage home`",
    }
}

fn for_frame(fault: &FrameFault) -> &'static str {
    match fault {
        FrameFault::NotRaw { .. } => {
            "the camera's program must write the sensor's counts untouched, as a grey PNG or TIFF of 8 or 16 bits, one value per pixel (of a raw file of a camera, `dcraw -D -4 -T` makes one)"
        }
        FrameFault::Size { .. } => {
            "resolution_px in the rig file must be what the camera, or its program, is set to"
        }
        FrameFault::Undecodable(_) => {
            "see whether the file or the frame is whole, and whether bit_depth in the rig file is the camera's"
        }
        FrameFault::Settings { what: "gain", .. } => {
            "set camera.gain in the rig file to a gain that the camera has, and pass {gain} on to it in camera.command, its automatic gain switched off"
        }
        FrameFault::Settings { .. } => {
            "pass {exposure_s} on to the camera in camera.command, its automatic exposure switched off; where it only rounds, camera.step_ms in the rig file must be its step, and shortest_ms and longest_ms its range"
        }
        FrameFault::LostPackets => {
            "give the camera a network interface of its own, with an MTU of 9000 for jumbo frames (`sudo ip link set eth1 mtu 9000`), and enlarge the receive buffer (`sudo sysctl net.core.rmem_max=33554432`)"
        }
        FrameFault::Damaged | FrameFault::Late => {
            "check the cable, and that nothing else shares the camera's USB bus"
        }
    }
}

/// What a camera's program may report stands in docs/camera-programs.md.
fn for_answer(fault: &AnswerFault) -> &'static str {
    match fault {
        AnswerFault::Malformed(_) => {
            "the program must print one JSON object as the last thing on stdout, such as {\"exposure_s\": 0.02, \"gain\": 1.0}; a line for people must not begin with {, and belongs on stderr"
        }
        AnswerFault::UnknownKey(_) => {
            "the keys are exposure_s, gain, serial and sensor_c; a key of the program's own begins with _"
        }
        AnswerFault::Range { .. } => {
            "exposure_s is in seconds (not ms or µs), gain a factor (not dB or ISO), sensor_c in °C; leave out what the camera does not report"
        }
    }
}

fn for_program(program: &str, fault: &ProgramFault) -> String {
    use ProgramFault::*;
    let hint = match fault {
        Missing { .. } if program == "gphoto2" => {
            "install it (on Debian and Ubuntu `sudo apt install gphoto2`)"
        }
        Missing { .. } if ["unprocessed_raw", "raw-identify"].contains(&program) => {
            "install LibRaw's programs (on Debian and Ubuntu `sudo apt install libraw-bin`)"
        }
        Missing {
            looked_in_path: true,
        } => "install it, or give its path in camera.command of the rig file",
        Missing {
            looked_in_path: false,
        } => {
            "correct the path in camera.command of the rig file: it counts from the folder the command runs in"
        }
        NotExecutable { .. } => {
            return format!("`chmod +x {program}` makes it one that may be executed");
        }
        Denied => {
            "check that its folders may be entered, and that its file system is not mounted `noexec`"
        }
        Folder => "name the program in it in camera.command of the rig file",
        WindowsLineEnds { .. } => {
            return format!(
                "it was saved with Windows line ends: `sed -i 's/\\r$//' {program}` (or dos2unix) removes them"
            );
        }
        NoInterpreter { .. } => {
            "install the interpreter, or correct the program's first line (`#!/usr/bin/env python3` finds it in PATH)"
        }
        NoLoader => "build or install it for this processor and system",
        NotAProgram => {
            "begin a script with a line such as #!/bin/sh, with nothing before the # (no byte order mark); a binary must be of this processor"
        }
        NoLibrary { .. } => {
            "install the library that it names (`ldd` on the program lists all), or name its folder in LD_LIBRARY_PATH"
        }
    };
    hint.to_owned()
}

# The driver `webcam`, nokhwa over Video4Linux, with `vivid` and `uvcvideo`: counts, settings
# in the images, frames that never come, damage that it could not see, unplugging, a capture.
# checks: 31
. /vm/checks.sh

modprobe vivid no_error_inj=0 n_devs=1 node_types=0x1
camera=/dev/video0
until_true 10 test -e $camera
set_control() { v4l2-ctl -d $camera -c "$1"; }
# A still picture: no text, no motion.
set_control osd_text_mode=2
start_usb nodrop=1
usb stage in
until_true 10 test -c /dev/ttyACM0

# bench NAME SERIAL WIDTH HEIGHT: a rig file with the driver.
bench() {
    sed -e 's/^driver = "v4l"/driver = "webcam"/' -e '/^format/d; /^controls/d; /^return_timeout_s/d' \
        -e "s/^name = .*/name = \"$1\"/; s/^serial = .*/serial = \"$2\"/" \
        -e "s/^resolution_px = .*/resolution_px = [$3, $4]/; s/^bit_depth = .*/bit_depth = 8/" \
        -e 's/^longest_ms = .*/longest_ms = 100.0/' /vm/rig.toml >"$1.toml"
}
cp -r /vm/calibration .
bench vivid vivid-000-vid-cap 320 180
grab() { run camera grab --rig "$rig.toml" "$@"; }

rig=vivid
run devices --json
listed='map(select(.driver == "webcam")) | .[0]'
check "listed" "$(json "$listed | tostring")" [ "$(json "$listed.serial")" = vivid-000-vid-cap ]
run camera info --rig vivid.toml --json
exits "opened without a control for its exposure" 0
v4l2-ctl -d $camera --set-fmt-video=width=320,height=180,pixelformat=YUYV \
    --stream-mmap=3 --stream-skip=2 --stream-count=1 --stream-to=frame.raw >/dev/null 2>&1
expected=$(od -An -v -tu1 -w2 frame.raw | awk 'NR == 1 { least = most = $1 }
    { sum += $1; if ($1 < least) least = $1; if ($1 > most) most = $1 }
    END { printf "%d %.6f %d", least, sum / NR, most }')
grab --discard 1 --json
found=$(jq -r '[.minimum_dn, .mean_dn, .maximum_dn] | @tsv' out | awk '{ printf "%d %.6f %d", $1, $2, $3 }')
check "the kernel tool's counts" "least, mean, greatest count $found" [ "$expected" = "$found" ]
run calibrate sensor --rig vivid.toml
exits "nothing is measured with it" 1 "no control for its exposure"
v4l2-ctl -d $camera --set-fmt-video=width=320,height=180,pixelformat=GREY >/dev/null
grab
exits "set to a format that nokhwa does not know" 1 "YUYV frames of 320"
v4l2-ctl -d $camera --set-fmt-video=width=320,height=180,pixelformat=YUYV >/dev/null

set_control percentage_of_dropped_buffers=100
begun=$(cut -d' ' -f1 /proc/uptime)
grab
exits "all buffers dropped" 1 "did not answer"
took=$(cut -d' ' -f1 /proc/uptime | awk -v begun="$begun" '{ print $1 - begun }')
# Two waits of frame_timeout_s, and what the program takes to start under emulation.
check "ends within its time-outs" "$took s" eval "awk 'BEGIN { exit !($took < 20) }'"
set_control percentage_of_dropped_buffers=0
set_control inject_vidioc_streamon_error=1
grab
exits "a stream that does not start" 1 video0
set_control inject_vidioc_reqbufs_error=1
grab
exits "no buffers" 1 video0
grab --json
exits "and whole again" 0
later camera grab --rig vivid.toml --discard 1000
sleep 4
set_control inject_fatal_streaming_error=1
finish
exits "a fatal error in mid-stream" 1 video0
later camera grab --rig vivid.toml --discard 1000
sleep 4
set_control disconnect=1
finish
exits "disconnected in mid-stream" 1 disconnected
modprobe -r vivid
until_true 10 eval "[ ! -e $camera ]"

usb camera in
until_true 10 test -e $camera
rig=webcam
bench webcam CAM0001 128 96
grab
exits "a kernel that hands damaged frames over" 1 nodrop
# It is read when a camera is plugged in.
echo 0 >/sys/module/uvcvideo/parameters/nodrop
usb camera out
until_true 10 eval "[ ! -e $camera ]"
usb camera in
until_true 10 test -e $camera
run camera info --rig webcam.toml --json
check "its exposures" "$(json '.exposure_range | tostring')" \
    eval '[ "$(json ".exposure_range == [0.0001, 1.0]")" = true ]'
sed 's/CAM0001/CAM0002/' webcam.toml >other.toml
run camera info --rig other.toml
exits "another camera's serial number" 1 "serial number is CAM0001"
sed '/^serial/d' webcam.toml >any.toml
run camera info --rig any.toml
exits "a rig file without a serial number" 1 "CAM0001"

# The black level of 64 DN, and of noise around it the part that 8 bits leave out: 3.53 DN.
signal() {
    grab --exposure-ms "$1" --gain "$2" --json
    json '.mean_dn - 3.53'
}
ratio() { awk "BEGIN { print ($1 / $2 > $3 * 0.97 && $1 / $2 < $3 * 1.03) ? 1 : 0 }"; }
short=$(signal 25 16)
long=$(signal 100 16)
check "four times the exposure" "$short DN, $long DN" [ "$(ratio "$long" "$short" 4)" = 1 ]
check "read back" "$(json '.settings | tostring')" \
    eval '[ "$(json ".settings == {\"exposure\": 0.1, \"gain\": 16}")" = true ]'
v4l2-ctl -d $camera -C auto_exposure,white_balance_automatic >modes
check "nothing automatic" "$(tr '\n' ' ' <modes)" eval 'grep -q "auto_exposure: 1" modes && grep -q "automatic: 0" modes'
usb camera stall
grab
exits "a stalled control" 1 "refused"
usb camera obey
for fault in damage cut; do
    later camera grab --rig webcam.toml --discard 30 --json
    sleep 3
    usb camera $fault 1
    finish
    exits "the kernel discards a frame with the fault: $fault" 0
done
usb camera silent
limit=90 grab
exits "a silent camera" 1 "did not answer"
usb camera send

cp -r calibration/vm calibration/deep
sed 's/^name = .*/name = "deep"/' webcam.toml >deep.toml
run capture --rig deep.toml --light 0,80 --no-fit --out deep
exits "a capture with a record of another bit depth" 1 "bit depth"
limit=240 run capture --rig webcam.toml --light 0,80 --no-fit --out whole --json
exits "a capture of one light" 0
check "its exposures are proven" "$(json .complete)" eval '[ "$(json .complete)" = true ]'
usb stage lamp
check "the lamp is off" "$usb_answer" [ "$usb_answer" = "[0.0, 0.0, 0.0]" ]
frames() { cat "$1"/*/journal.jsonl 2>/dev/null | grep -c '_light.png'; }
more_than() { [ "$(frames "$1")" -ge "$2" ]; }
limit=240
later capture --rig webcam.toml --light 0,80 --no-fit --out returned --json
until_true 90 more_than returned 2
usb camera out
sleep 2
usb camera in
finish
exits "unplugged in a capture and back" 0
later camera grab --rig webcam.toml --discard 1000
sleep 4
usb camera out
finish
exits "unplugged in mid-stream" 1 disconnected
run camera info --rig webcam.toml
exits "opened while it is away" 1 video0
usb camera in
until_true 10 test -e $camera
grab
exits "plugged in again" 0

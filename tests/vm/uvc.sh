# `uvcvideo` with the simulated USB camera: controls, exposure and gain in the
# images, stalls, damaged and cut frames, silence, unplugging.
# checks: 26
. /vm/checks.sh

start_usb
usb camera in
camera=/dev/video0
until_true 10 test -e $camera

run devices --json
check "listed with its serial number" "$(json '.[0] | [.model, .serial, .usb] | tostring')" \
    [ "$(json '.[0].serial')" = CAM0001 ]
run camera info --device $camera --json
check "its exposures" "$(json '.exposure_range | tostring')" \
    eval '[ "$(json ".exposure_range == [0.0001, 1.0]")" = true ]'
run camera controls --device $camera --json
check "its controls" "$(json 'map(.label) | tostring')" \
    eval '[ "$(json "map(select(.kind != \"other\")) | length")" = 6 ]'

# signal MS GAIN: mean count of a frame above black, which is 64 DN.
signal() {
    run camera grab --device $camera --format Y16 --exposure-ms "$1" --gain "$2" --json
    json '.mean_dn - 64'
}
ratio() { awk "BEGIN { print ($1 / $2 > $3 * 0.97 && $1 / $2 < $3 * 1.03) ? 1 : 0 }"; }
# The room's light alone: tens of DN.
short=$(signal 100 1)
long=$(signal 400 1)
check "four times the exposure" "$short DN, $long DN" [ "$(ratio "$long" "$short" 4)" = 1 ]
amplified=$(signal 100 4)
check "four times the gain" "$short DN, $amplified DN" [ "$(ratio "$amplified" "$short" 4)" = 1 ]
check "read back" "$(json '.settings | tostring')" \
    eval '[ "$(json ".settings == {\"exposure\": 0.1, \"gain\": 4}")" = true ]'
v4l2-ctl -d $camera -C auto_exposure,white_balance_automatic >modes
check "nothing automatic" "$(tr '\n' ' ' <modes)" eval 'grep -q "auto_exposure: 1" modes && grep -q "automatic: 0" modes'
for format in YUYV GREY RG16; do
    run camera grab --device $camera --format $format --exposure-ms 400 --json
    check "format $format" "mean $(json .mean_dn) DN" eval '[ "$(json ".mean_dn > 4")" = true ]'
done

usb camera stall
run camera grab --device $camera --format Y16
exits "a stalled control" 1 "refused"
usb camera obey
run camera grab --device $camera --format Y16
exits "and after it" 0

# The driver throws damaged and cut frames away by itself.
for fault in damage cut; do
    later camera grab --device $camera --format Y16 --discard 60 --json
    sleep 1.5
    usb camera $fault 1
    finish
    exits "a frame with the fault: $fault" 0
    check "is never handed over" "$(json '.retakes | tostring')" [ "$(json '.retakes.damaged // 0')" = 0 ]
done

usb camera silent
limit=90 run camera grab --device $camera --format Y16
exits "a silent camera" 1 "did not answer"
usb camera send

# A frame takes as long as its exposure: how many it costs.
run camera grab --device $camera --format Y16 --exposure-ms 200 --discard 0
later camera grab --device $camera --format Y16 --exposure-ms 200 --discard 19 --json
begun=$(cut -d' ' -f1 /proc/uptime)
finish
took=$(cut -d' ' -f1 /proc/uptime | awk -v begun="$begun" '{ print $1 - begun }')
check "20 frames of 200 ms" "$took s" eval "awk 'BEGIN { exit !($took < 6.5) }'"

# Sure to be in mid-stream.
later camera grab --device $camera --format Y16 --discard 1000
sleep 2
usb camera out
finish
exits "unplugged in mid-stream" 1 disconnected
run camera info --device $camera
exits "opened while it is away" 1 "video0"
usb camera in
until_true 10 test -e $camera
run camera grab --device $camera --format Y16
exits "plugged in again" 0

usb camera out
until_true 10 eval "[ ! -e $camera ]"
# Now the driver hands damaged frames over, flagged.
echo 1 >/sys/module/uvcvideo/parameters/nodrop
usb camera in
until_true 10 test -e $camera
for fault in damage cut; do
    later camera grab --device $camera --format Y16 --discard 60 --json
    sleep 1.5
    usb camera $fault 1
    finish
    exits "handed over with the fault: $fault" 0
    check "is taken again" "$(json '.retakes | tostring')" [ "$(json .retakes.damaged)" = 1 ]
done
usb camera damage 1000
run camera grab --device $camera --format Y16
exits "only damaged frames" 1 damaged

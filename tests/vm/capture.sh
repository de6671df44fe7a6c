# A whole capture through `uvcvideo` and `cdc_acm`: its exposures checked in the
# images, the camera and the stage pulled out on the way, resumed.
# checks: 13
. /vm/checks.sh

start_usb
usb camera in
usb stage in
until_true 10 test -c /dev/ttyACM0 -a -e /dev/video0
dark="[0.0, 0.0, 0.0]"
limit=240

run doctor --rig /vm/rig.toml --json
check "examined" "exit code $code" eval 'jq -e . out'

run capture --rig /vm/rig.toml --light 0,80 --light 60,70 --no-fit --out whole --json
exits "two lights" 0
check "wall time over that of the devices" "$(json .wall_over_devices)" eval '[ "$(json .complete)" = true ]'
session=$(json .session)
run session verify "$session" --json
check "its files" "$(json '[.files, .bytes] | tostring')" eval '[ "$(json ".intact and .complete")" = true ]'
usb stage lamp
check "the lamp is off" "$usb_answer" [ "$usb_answer" = "$dark" ]

frames() { cat "$1"/*/journal.jsonl 2>/dev/null | grep -c '_light.png'; }
more_than() { [ "$(frames "$1")" -ge "$2" ]; }

# Back before return_timeout_s: it goes on by itself.
later capture --rig /vm/rig.toml --light 0,80 --no-fit --out returned --json
until_true 60 more_than returned 3
usb camera out
sleep 2
usb stage lamp
check "the lamp while the camera is away" "$usb_answer" [ "$usb_answer" = "$dark" ]
usb camera in
finish
exits "the camera was gone and back" 0
check "goes on by itself" "$(grep -h '"camera' out | head -n 1)" eval '[ "$(json .complete)" = true ]'
reconnected() { cat returned/*/raw/*.toml | grep -c '^reconnected = 1'; }
check "its sidecar says so" "$(reconnected) frame" [ "$(reconnected)" = 1 ]

# It came back under another name, which only its serial number finds.
usb camera out
until_true 10 eval '[ ! -e /dev/video0 ] && [ ! -e /dev/video1 ]'
usb camera in
until_true 10 test -e /dev/video0

later capture --rig /vm/rig.toml --light 0,80 --no-fit --out broken --json
until_true 60 more_than broken 3
usb stage out
finish
exits "the stage is unplugged" 1 disconnected
session=$(echo broken/*)
kept=$(frames broken)
check "frames kept" "$kept" [ "$kept" -ge 3 ]
usb stage in
until_true 10 test -c /dev/ttyACM0
run capture --resume "$session" --no-fit --json
exits "resumed" 0
run session verify "$session" --json
check "its files" "$(json '[.files, .bytes] | tostring')" eval '[ "$(json ".intact and .complete")" = true ]'

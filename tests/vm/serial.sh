# `cdc_acm`, or the port that ftdi.sh chooses, with the simulated GRBL firmware:
# opening, homing, moving, the lamp, and the cable pulled while the stage moves.
# checks: 16
. /vm/checks.sh

port=${port:-/dev/ttyACM0} plug_in=${plug_in:-in} serial=${serial:-STAGE0001}
sed "s#^port = .*#port = \"$port\"#" /vm/rig.toml >rig.toml
start_usb
usb stage $plug_in
until_true 10 test -c $port

run devices --json
check "listed with its serial number" "$(json '.[0] | [.model, .serial, .usb] | tostring')" \
    [ "$(json '.[0].serial')" = "$serial" ]
run stage status --port $port --json
exits "asked" 0
check "locked until it is homed" "$(json .status.activity)" [ "$(json .status.activity)" = alarm ]
run stage home --port $port --json
exits "homed" 0
run stage move --rig rig.toml --azimuth -30 --elevation 60 --json
exits "moved" 0
usb stage angles
check "stands there" "$usb_answer" [ "$usb_answer" = "[-30.000, 60.000]" ]

dark="[0.0, 0.0, 0.0]"
later stage lamp 1 --seconds 3 --home --rig rig.toml
lit() { usb stage lamp && [ "$usb_answer" = "[0.0, 1.0, 0.0]" ]; }
until_true 20 lit
check "the lamp is lit" "$usb_answer" [ "$usb_answer" = "[0.0, 1.0, 0.0]" ]
finish
exits "and goes off" 0
usb stage lamp
check "as the firmware has it" "$usb_answer" [ "$usb_answer" = "$dark" ]

# Killed outright: the guardian holds the port.
later stage lamp 1 --home --rig rig.toml
until_true 20 lit
kill -9 $process
wait $process 2>/dev/null
is_dark() { usb stage lamp && [ "$usb_answer" = "$dark" ]; }
until_true 3 is_dark
check "killed: dark within 3 s" "$usb_answer" [ "$usb_answer" = "$dark" ]

later stage home --rig rig.toml
moves() { usb stage angles; was=$usb_answer; sleep 0.3; usb stage angles; [ "$was" != "$usb_answer" ]; }
until_true 30 moves
usb stage out
finish
exits "unplugged in mid-motion" 1 disconnected
run stage status --port $port
exits "opened while it is away" 1 "${port#/dev/}"
usb stage $plug_in
until_true 10 test -c $port
# The board kept its power, and ends what it was told.
until_true 60 eval 'usb stage angles; last=$usb_answer; sleep 0.5; usb stage angles; [ "$last" = "$usb_answer" ]'
before=$usb_answer
run stage status --port $port --json
exits "plugged in again" 0
check "its position is unknown" "$(json '.status | tostring')" [ "$(json .status.position)" = null ]
usb stage angles
check "and nothing moved" "$usb_answer" [ "$usb_answer" = "$before" ]
run stage home --port $port
exits "homed again" 0

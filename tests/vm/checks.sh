# What the scenarios share. Each check writes one line that the host counts:
# `check: ok|FAILED  what  (seen)`.

scenario=$(basename "$0" .sh)
rm -rf "/tmp/$scenario" && mkdir "/tmp/$scenario" && cd "/tmp/$scenario" || exit 1

# check WHAT SEEN COMMAND…: the command decides.
check() {
    what=$1 seen=$2
    shift 2
    if "$@" >/dev/null 2>&1; then verdict=ok; else verdict=FAILED; fi
    echo "check: $verdict | $scenario | $what | $seen"
    [ $verdict = ok ] || show
}

# What the last run of rig said, for who looks into a failure.
show() {
    sed 's/^/    stdout: /' out 2>/dev/null | head -c 1500
    sed 's/^/    stderr: /' err 2>/dev/null | head -c 1500
}

# run ARGUMENTS…: rig with a limit; exit code in $code, output in out and err.
run() {
    timeout "${limit:-60}" rig "$@" >out 2>err
    code=$?
}

# json FILTER: of the last output.
json() { jq -r "$1" out 2>/dev/null; }

# exits WHAT CODE [PATTERN]: where it is a failure with a fact, which the pattern
# matches, and a hint.
exits() {
    if [ "$2" = 0 ]; then
        check "$1" "exit code $code" [ "$code" = 0 ]
    else
        # The guardian may have a fact of its own before it.
        fact=$(sed -n 's/^error: //p' err | tail -n 1)
        hinted() { [ "$code" = "$1" ] && echo "$fact" | grep -qi -- "$2" && grep -q '^hint: ' err; }
        check "$1" "exit code $code: $fact" hinted "$2" "$3"
    fi
}

# later COMMAND…: rig in the background, as `finish` ends it.
later() {
    rig "$@" >out 2>err &
    process=$!
}

finish() {
    until_true "${limit:-60}" eval "! kill -0 $process" || kill -9 "$process"
    wait "$process"
    code=$?
}

# until_true SECONDS COMMAND…
until_true() {
    local left=$((10 * $1))
    shift
    while ! "$@" >/dev/null 2>&1; do
        left=$((left - 1))
        [ $left -gt 0 ] || return 1
        sleep 0.1
    done
}

# The simulated USB devices: plug COMMAND… waits for their confirmation.
start_usb() {
    modprobe vhci-hcd
    modprobe cdc-acm
    modprobe ftdi_sio
    modprobe uvcvideo "$@"
    mkfifo to_usb
    : >usb_said
    usb_devices <to_usb >usb_said 2>usb_errors &
    exec 3>to_usb
}

usb() {
    local said=$(wc -l <usb_said)
    echo "$*" >&3
    until_true 10 eval "[ \$(wc -l <usb_said) -gt $said ]" || echo "usb_devices does not answer: $*"
    usb_answer=$(tail -n 1 usb_said)
    case $usb_answer in
    "done:"*) usb_answer=${usb_answer#"done: $* "} ;;
    *) echo "    usb_devices: $usb_answer $(cat usb_errors)" ;;
    esac
}

# `vivid`, the kernel's virtual camera: formats, damaged and dropped buffers,
# refused streams, disconnection.
# checks: 39
. /vm/checks.sh

modprobe vivid no_error_inj=0 n_devs=1 node_types=0x1
camera=/dev/video0
until_true 10 test -e $camera
set_control() { v4l2-ctl -d $camera -c "$1"; }
# A still picture: no text, no motion.
set_control osd_text_mode=2

run devices --json
check "listed" "$(json '.[0].model // .devices[0].model')" grep -q vivid out
run camera controls --device $camera --json
check "controls" "$(json length) controls" [ "$(json length)" -gt 30 ]
run camera info --device $camera --json
exits "opened without a control for its exposure" 0

# Every format against the same frame as the kernel's own tool gets it: least,
# greatest and sum of the counts.
counted() {
    case $1 in
    bytes) od -An -v -tu1 -w2 frame.raw | awk '{ for (i = 1; i <= NF; i++) print $i }' ;;
    luma) od -An -v -tu1 -w2 frame.raw | awk '{ print $1 }' ;;
    little) od -An -v -tu1 -w2 frame.raw | awk '{ print $1 + 256 * $2 }' ;;
    esac | awk 'NR == 1 { least = most = $1 }
        { sum += $1; if ($1 < least) least = $1; if ($1 > most) most = $1 }
        END { printf "%d %.6f %d", least, sum / NR, most }'
}
for format in YUYV:luma GREY:bytes Y10:little Y12:little Y16:little \
    BA81:bytes GBRG:bytes GRBG:bytes RGGB:bytes BG10:little GB10:little BA10:little \
    RG10:little BG12:little GB12:little BA12:little RG12:little BYR2:little \
    GB16:little GR16:little RG16:little; do
    code_=${format%:*}
    asked=$(printf '%-4s' "$code_")
    v4l2-ctl -d $camera --set-fmt-video=width=320,height=180,pixelformat="$asked" \
        --stream-mmap=3 --stream-skip=2 --stream-count=1 --stream-to=frame.raw >/dev/null 2>&1
    expected=$(counted "${format#*:}")
    run camera grab --device $camera --format "$code_" --discard 1 --json
    found=$(jq -r '[.minimum_dn, .mean_dn, .maximum_dn] | @tsv' out | awk '{ printf "%d %.6f %d", $1, $2, $3 }')
    check "format $code_" "least, mean, greatest count $found" [ "$expected" = "$found" ]
done
run camera preview --device $camera --format NV12 --json
exits "NV12 in a preview" 0
run camera grab --device $camera --format RGB3
exits "RGB3 is refused" 1 format

# The next buffer carries the error flag: it is the first frame's.
set_control inject_v4l2_buf_flag_error=1
run camera grab --device $camera --format GREY --discard 0 --json
exits "a damaged buffer" 0
check "is taken again" "$(json '.retakes | tostring')" [ "$(json .retakes.damaged)" = 1 ]

# Slow enough that the next frame is always waited for.
v4l2-ctl -d $camera --set-parm=5 >/dev/null
set_control percentage_of_dropped_buffers=40
run camera grab --device $camera --format GREY --discard 20 --json
exits "40% of the buffers dropped" 0
check "leave gaps in the numbers" "the 21st frame is number $(json .sequence)" [ "$(json .sequence)" -ge 25 ]
set_control percentage_of_dropped_buffers=100
limit=60 run camera grab --device $camera --format GREY
exits "all buffers dropped" 1 "no reply\|did not answer"
set_control percentage_of_dropped_buffers=0

set_control wrap_sequence_number=1
run camera grab --device $camera --format GREY --discard 20 --json
exits "running numbers that wrap" 0
check "are no loss" "$(json '.retakes | tostring')" [ "$(json '.retakes.dropped // 0')" = 0 ]
set_control wrap_sequence_number=0

set_control inject_vidioc_streamon_error=1
run camera grab --device $camera --format GREY
exits "a stream that does not start" 1 video0
set_control inject_vidioc_reqbufs_error=1
run camera grab --device $camera --format GREY
exits "no buffers" 1 video0
run camera grab --device $camera --format GREY --json
exits "and whole again" 0

later camera grab --device $camera --format GREY --discard 1000
sleep 2
set_control inject_fatal_streaming_error=1
finish
exits "a fatal error in mid-stream" 1 video0
later camera grab --device $camera --format GREY --discard 1000
sleep 2
set_control disconnect=1
finish
exits "disconnected in mid-stream" 1 disconnected
run camera grab --device $camera --format GREY
exits "and back" 0
modprobe -r vivid

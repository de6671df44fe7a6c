#!/bin/bash
# rig against the kernel's own drivers in a virtual machine under software
# emulation, which boots anew for each scenario: run.sh RIG USB_DEVICES [SCENARIO…].
# Everything is kept in target/vm.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
work=$here/../../target/vm
rig=$(realpath "$1") usb_devices=$(realpath "$2")
shift 2
scenarios=${*:-vivid uvc webcam serial ftdi capture}
mkdir -p "$work"
work=$(cd "$work" && pwd)

sudo=$([ "$(id -u)" = 0 ] || echo sudo)
needed=
for package in qemu-system-x86 busybox-static v4l-utils kmod cpio jq binutils; do
    dpkg-query -W -f='${Status}' $package 2>/dev/null | grep -q 'ok installed' || needed+=" $package"
done
if [ -n "$needed" ]; then
    $sudo apt-get update
    # shellcheck disable=SC2086
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $needed
fi

# Debian's kernel, unpacked and not installed.
kernel=$(apt-cache depends linux-image-amd64 | sed -n 's/.*Depends: //p' | grep -m1 '^linux-image-[0-9]')
version=${kernel#linux-image-}
if [ ! -e "$work/$kernel/boot/vmlinuz-$version" ]; then
    rm -rf "${work:?}/$kernel"
    (cd "$work" && apt-get download "$kernel" && dpkg-deb -x "$kernel"_*.deb "$kernel" && rm "$kernel"_*.deb)
    /sbin/depmod -b "$work/$kernel" "$version"
fi

# The machine's files: busybox, the programs with their libraries, the modules.
root=$work/root
rm -rf "$root"
mkdir -p "$root"/{bin,sbin,proc,sys,dev,tmp,usr/bin,vm} "$root/lib/modules/$version"
cp /bin/busybox "$root/bin/"
for applet in $(/bin/busybox --list); do
    [ -e "$root/bin/$applet" ] || ln -s busybox "$root/bin/$applet"
done
ln -s /bin/busybox "$root/sbin/modprobe"
install_program() {
    cp -L "$1" "$root/usr/bin/$2"
    { ldd "$1" || true; } | grep -oE '/[^ ]+' | while read -r library; do
        mkdir -p "$root$(dirname "$library")"
        cp -nL "$library" "$root$library"
    done
}
install_program "$rig" rig
install_program "$usb_devices" usb_devices
install_program /usr/bin/v4l2-ctl v4l2-ctl
install_program /usr/bin/jq jq
strip --strip-debug "$root/usr/bin/rig" "$root/usr/bin/usb_devices"
for module in vivid uvcvideo vhci-hcd cdc-acm ftdi_sio; do
    /sbin/modprobe -d "$work/$kernel" -S "$version" --show-depends "$module" |
        sed -n "s#^insmod .*/lib/modules/$version/\([^ ]*\).*#\1#p"
done | sort -u | while read -r module; do
    mkdir -p "$root/lib/modules/$version/$(dirname "$module")"
    cp "$work/$kernel/lib/modules/$version/$module" "$root/lib/modules/$version/$module"
done
cp "$work/$kernel/lib/modules/$version"/modules.{builtin,builtin.modinfo,order} "$root/lib/modules/$version/"
/sbin/depmod -b "$root" "$version"
cp -r "$here"/*.sh "$here/rig.toml" "$here/calibration" "$root/vm/"
cp "$here/init" "$root/init"
chmod 755 "$root/init"
(cd "$root" && find . | cpio -o -H newc --quiet) | gzip -1 >"$work/initramfs.gz"

# One machine for each: what a scenario unplugs, or leaves in the kernel, is not
# the next one's. Software emulation, so that it runs wherever the tests do.
boot() {
    timeout "${LIMIT_S:-600}" qemu-system-x86_64 -accel tcg,thread=multi -cpu max -smp 2 -m 1536 \
        -nodefaults -nographic -no-reboot -serial stdio \
        -kernel "$work/$kernel/boot/vmlinuz-$version" -initrd "$work/initramfs.gz" \
        -append "console=ttyS0 quiet panic=1 mitigations=off rig_scenario=$1" \
        </dev/null 2>&1 | stdbuf -oL tr -d '\r' | tee "$work/$1.txt" || true
}

# Both counts must be there: a scenario that ends early is a failure.
failures=0
summary=$work/summary.txt
echo "scenario    passed  failed  seconds" >"$summary"
for scenario in $scenarios; do
    begun=$SECONDS
    boot "$scenario"
    log=$work/$scenario.txt
    passed=$(grep -c "^check: ok | $scenario |" "$log" || true)
    failed=$(grep -c "^check: FAILED | $scenario |" "$log" || true)
    expected=$(sed -n 's/^# checks: //p' "$here/$scenario.sh")
    printf '%-10s %7d %7d %8d\n' "$scenario" "$passed" "$failed" $((SECONDS - begun)) >>"$summary"
    if [ "$passed" != "$expected" ] || ! grep -q '^vm: finished' "$log"; then
        failures=$((failures + 1))
        echo "error: $scenario has $expected checks; its console: $log" >>"$summary"
    fi
    # vhci-hcd of Linux 6.1 sometimes follows a null pointer when a device is
    # pulled out in mid-transfer, and takes the process down that uses it.
    if grep -q 'BUG: kernel' "$log"; then
        echo "error: the kernel itself failed; run $scenario again" >>"$summary"
    fi
done
echo
cat "$summary"
echo "Linux $version"
[ "$failures" = 0 ]

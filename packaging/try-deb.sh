#!/bin/sh
# Installs a package in a fresh Debian root and uses it there as an ordinary user:
# try-deb.sh FILE.deb [SUITE]. Needs root and mmdebstrap; takes about two minutes.
set -eu
deb=$(realpath "$1")
suite=${2:-bookworm}
root=$(mktemp -d "${TMPDIR:-/tmp}/rig-root.XXXXXX")
trap 'umount --recursive "$root/proc" "$root/dev" 2>/dev/null || :; rm -rf --one-file-system "$root"' EXIT
step() { printf '\n== %s\n' "$*"; }
inside() { chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive "$@"; }
as_user() { inside su --login --shell /bin/bash researcher --command "$*"; }
fail() { echo "try-deb: $*" >&2; exit 1; }

step "a fresh $suite"
mmdebstrap --quiet --variant=apt --include=man-db,bash-completion,udev,ca-certificates "$suite" "$root"
cp /etc/apt/sources.list* "$root/etc/apt/" 2>/dev/null || :
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount --make-rslave "$root/dev"

step "apt install"
cp "$deb" "$root/tmp/rig.deb"
inside apt-get update -qq
inside apt-get install -qq --no-install-recommends /tmp/rig.deb
inside useradd --create-home --shell /bin/bash researcher

step "version, manual pages, completions"
as_user rig --version
as_user "MANWIDTH=80 man rig-capture | head -n 12"
as_user "man --where rig-fit" | grep -q man1/rig-fit.1 || fail "no manual page"
completed=$(as_user "bash -ic '. /usr/share/bash-completion/bash_completion; _completion_loader rig;
  COMP_WORDS=(rig ca); COMP_CWORD=1; COMP_LINE=\"rig ca\"; COMP_POINT=6; _rig rig ca rig; echo \${COMPREPLY[*]}' 2>/dev/null")
echo "rig ca<Tab>: $completed"
case $completed in *capture*) ;; *) fail "no completion for rig ca" ;; esac

step "cameras through nokhwa and Aravis are offered"
for driver in webcam genicam; do
  as_user "rig init --questions --json" | grep -q "\"value\": *\"$driver" || fail "no driver $driver"
done

step "udev reads the rules"
inside udevadm test --action=add /sys/class/mem/null >"$root/tmp/udev.log" 2>&1 || :
grep 'Reading rules file: /usr/lib/udev/rules.d/70-rig.rules' "$root/tmp/udev.log" || fail "udev does not read 70-rig.rules"
! grep '70-rig.rules:' "$root/tmp/udev.log" || fail "udev objects to the rules"

step "Debian's own rig"
inside apt-get install --yes --simulate rig | grep -E '^(Remv|Inst) rig' ||
  fail "apt would install both"
inside sh -c 'cd /tmp && apt-get download rig && ! dpkg --install rig_*.deb' 2>&1 | grep -i conflict ||
  fail "dpkg would install both"

step "a whole measurement on the simulated bench, as an ordinary user"
as_user "rig demo --out sessions" | tail -n 3
as_user "ls sessions/*/report.html"

step "removed"
inside apt-get purge --yes rig-reflectometry >/dev/null
left=$(find "$root/usr" -xdev -path '*rig-reflectometry*' -o -path "$root/usr/*" -name 'rig*' -path '*bin*')
[ -z "$left" ] || fail "left behind: $left"
echo "The package works in a fresh $suite and leaves nothing behind."

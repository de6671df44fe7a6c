#!/bin/sh
# A batch and an experiment on a Slurm of one node, with tasks that are killed: slurm.sh RIG_BINARY
# Needs root, and Debian's packages slurm-wlm and munge, which it installs.
# Fails where they cannot be had, unless ALLOW_SKIP=1.
set -eu
here=$(dirname "$0")

skip() {
    echo "test-external SKIPPED: $1; nothing was run on Slurm" >&2
    [ "${ALLOW_SKIP:-0}" = 1 ] && exit 0
    exit 1
}

[ "$(id -u)" = 0 ] || skip "Slurm's daemons need root"
if ! command -v slurmctld >/dev/null || ! command -v munged >/dev/null; then
    command -v apt-get >/dev/null || skip "there is no apt-get"
    apt-get update -qq || skip "apt-get update failed"
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends slurm-wlm munge \
        >/dev/null || skip "slurm-wlm and munge could not be installed"
fi
exec python3 "$here/slurm.py" "$@"

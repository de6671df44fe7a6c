#!/bin/sh
# Exports loaded in the programs they are for, the notebooks, and batches run by those who run
# jobs: run.sh RIG_BINARY WHEEL
# Fails where one of these programs cannot be had, unless ALLOW_SKIP=1.
set -eu
here=$(dirname "$0")
venv=target/external-venv

skip() {
    echo "test-external SKIPPED: $1; nothing was compared" >&2
    [ "${ALLOW_SKIP:-0}" = 1 ] && exit 0
    exit 1
}

[ -x "$venv/bin/python" ] || python3 -m venv "$venv" || skip "there is no Python with venv"
"$venv/bin/pip" install --quiet -r "$here/requirements.txt" || skip "Mitsuba 3 could not be installed"
"$venv/bin/python" -c 'import mitsuba' || skip "Mitsuba 3 cannot be imported"
"$venv/bin/python" "$here/mitsuba_export.py" "$1"
"$venv/bin/python" "$here/mitsuba_render.py" "$1"
"$venv/bin/python" "$here/mitsuba_images.py" "$1"
"$venv/bin/python" "$here/birdf.py" "$1"
"$here/models.sh" "$1" "$venv/bin/python"

# The notebooks, with the wheel as it is now.
"$venv/bin/pip" install --quiet --force-reinstall --no-deps "$2"
RIG=$(realpath "$1") "$venv/bin/python" -m pytest -q --nbmake --nbmake-timeout=1800 "$here/../../python/notebooks"

# Batches.
"$venv/bin/python" "$here/snakemake_batch.py" "$1" "$venv/bin/snakemake"
"$here/slurm.sh" "$1"

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
<<<<<<< HEAD

# The notebooks, with the wheel as it is now.
"$venv/bin/pip" install --quiet --force-reinstall --no-deps "$2"
RIG=$(realpath "$1") "$venv/bin/python" -m pytest -q --nbmake "$here/../../python/notebooks"
# Materials in the models of other programs, in an environment of their own: Blender brings
# its NumPy.
models=target/external-models-venv
[ -x "$models/bin/python" ] || python3 -m venv "$models" || skip "there is no Python with venv"
"$models/bin/pip" install --quiet -r "$here/requirements-models.txt" || skip "MaterialX and Blender could not be installed"
"$models/bin/python" "$here/materialx_document.py" "$1"
if "$models/bin/python" -c 'import bpy' 2>/dev/null; then
    "$models/bin/python" "$here/blender_render.py" "$1"
else
    echo "Blender SKIPPED: the package bpy is for Python 3.11" >&2
    [ "${ALLOW_SKIP:-0}" = 1 ] || exit 1
fi
"$venv/bin/python" "$here/mitsuba_principled.py" "$1"
validator=target/gltf-validator
mkdir -p "$validator"
npm install --silent --no-audit --no-fund --prefix "$validator" gltf-validator@2.0.0-dev.3.10 || skip "the glTF validator could not be installed"
for material in red-plastic light-brown-fabric silver-paint; do
    "$1" brdf convert "nbrdf:$material" --out "$validator/$material.glb" > /dev/null
done
node "$here/gltf_validate.mjs" "$validator" "$validator"/*.glb
"$venv/bin/python" "$here/birdf.py" "$1"
=======
"$venv/bin/python" "$here/snakemake_batch.py" "$1" "$venv/bin/snakemake"
"$here/slurm.sh" "$1"
>>>>>>> batch

#!/bin/sh
# Materials in the models of other programs, loaded there: models.sh RIG_BINARY MITSUBA_PYTHON
# Blender and MaterialX are in an environment of their own, because Blender brings its NumPy.
set -eu
here=$(dirname "$0")
models=target/external-models-venv
validator=target/gltf-validator

skip() {
    echo "models SKIPPED: $1" >&2
    [ "${ALLOW_SKIP:-0}" = 1 ] && exit 0
    exit 1
}

[ -x "$models/bin/python" ] || python3 -m venv "$models" || skip "there is no Python with venv"
"$models/bin/pip" install --quiet -r "$here/requirements-models.txt" || skip "MaterialX and Blender could not be installed"
"$models/bin/python" "$here/materialx_document.py" "$1"
if ! "$models/bin/python" -c 'import moderngl; moderngl.create_standalone_context(backend="egl")' 2>/dev/null; then
    apt-get install -y -qq --no-install-recommends libegl1 libgl1 libgl1-mesa-dri >/dev/null ||
        skip "OpenGL in software (libegl1, libgl1, libgl1-mesa-dri) could not be installed"
fi
"$models/bin/python" "$here/materialx_shading.py" "$1"
"$models/bin/python" -c 'import bpy' || skip "the package bpy is for Python 3.11"
"$models/bin/python" "$here/blender_render.py" "$1"
"$2" "$here/mitsuba_principled.py" "$1"
mkdir -p "$validator"
npm install --silent --no-audit --no-fund --prefix "$validator" gltf-validator@2.0.0-dev.3.10 ||
    skip "the glTF validator could not be installed"
for material in red-plastic light-brown-fabric silver-paint; do
    "$1" brdf convert "nbrdf:$material" --out "$validator/$material.glb" >/dev/null
done
node "$here/gltf_validate.mjs" "$validator" "$validator"/*.glb

"""Renders the extruded designed shape, a mesh of long strips, and compares with Mitsuba 3's
images of the same mesh. See README.md here.

Usage: mitsuba_render.py RIG_BINARY
"""

import sys
import tempfile
from pathlib import Path

import mitsuba as mi
import numpy as np

from mitsuba_bench import camera, rig, scene

RESOLUTION, SAMPLES = 48, 256
ALBEDO = 0.8
# Coaxial; across the strips; and mostly along them, close to the diagonal of two axes.
LIGHTS = {"coaxial": [0, 0, 1], "across": [0.55, 0.05, 0.8], "along": [0.4747, 0.6224, 0.6223]}
# Of the mean radiance, relative. Measured: README.md.
ALLOWED = 0.004


def rig_image(folder, mesh, to_light, reflections):
    description, out = folder / "scene.toml", folder / "image.exr"
    description.write_text(
        f"""{camera(RESOLUTION)}
[sample]
mesh = "{mesh.name}"
shading = "flat"

[[light]]
kind = "directional"
to_light = {to_light}
irradiance = 1.0

[brdf]
mixture = [{{ lambertian = {{ albedo = {ALBEDO} }}, weight = 1.0 }}]
"""
    )
    rig("render", "--scene", description, "--out", out, "--spp", SAMPLES, "--max-reflections", reflections)
    bitmap = mi.Bitmap(str(out))
    channel = [field.name for field in bitmap.struct_()].index("G")
    return np.array(bitmap)[..., channel]


def mitsuba_image(mesh, to_light, reflections):
    sample = {
        "type": "ply", "filename": str(mesh), "face_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}},
    }  # fmt: skip
    bench = scene(RESOLUTION, to_light, reflections, sample)
    return np.array(mi.render(bench, spp=SAMPLES, seed=1))[..., 1]


def main():
    mi.set_variant("scalar_rgb")
    failed = False
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        mesh = folder / "designed.ply"
        rig("shape", "designed", "--radius", 0.3205, "--length", 2, "--segments", 192, "--out", mesh)
        for name, light in LIGHTS.items():
            to_light = (np.array(light) / np.linalg.norm(light)).tolist()
            for reflections in (1, 2, 16):
                ours = rig_image(folder, mesh, to_light, reflections)
                theirs = mitsuba_image(mesh, to_light, reflections)
                off = ours.mean() / theirs.mean() - 1
                ok = abs(off) <= ALLOWED
                failed |= not ok
                verdict = "ok" if ok else "FAILED"
                print(
                    f"{verdict:6} designed shape, light {name}, {reflections} reflections: mean radiance "
                    f"{100 * off:+.2f}% from Mitsuba's (allowed {100 * ALLOWED:g}%)",
                    flush=True,
                )
    sys.exit(1 if failed else 0)


main()

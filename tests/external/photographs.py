"""A real ball under 96 lights: four photographs predict the other 92.

photographs.py RIG BALL: BALL is the folder data/DiLiGenT/pmsData/ballPNG of the repository
t-taniai/neuralps (for research only, so not part of this source). Prints the table of
docs/measurements/photographs.md, and fails where an error is 1.1 times what stands there,
or where the intervals hold too few or too many of the values.
"""

import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

rig, ball = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
RADIUS_PX, CENTRE_PX = 70.7508, (307.8699, 263.8680)  # a sphere through the normals that are given
MM = 0.1  # of a pixel
FITTED = "33,40,81,88"
MOST = {"overall": 1.1 * 0.055, "away": 1.1 * 0.033, "highlight": 1.1 * 0.115}


def scene():
    x, y = (CENTRE_PX[0] - 305.5) * MM, -(CENTRE_PX[1] - 255.5) * MM
    text = (
        '[camera]\nmodel = "orthographic"\nresolution_px = [612, 512]\nextent_mm = [61.2, 51.2]\n'
        f"position_mm = [{-x:.6f}, {-y:.6f}, 300.0]\nlook_at_mm = [{-x:.6f}, {-y:.6f}, 0.0]\n\n"
    )
    numbers = lambda name: [line.split() for line in open(ball / name)]
    for to, strength in zip(numbers("light_directions.txt"), numbers("light_intensities.txt")):
        irradiance = [float(s) * 65535 * math.pi for s in strength]
        text += (
            f'[[light]]\nkind = "directional"\nto_light = [{", ".join(to)}]\n'
            f"irradiance = [{', '.join(f'{e:.1f}' for e in irradiance)}]\n\n"
        )
    shape = f'kind = "sphere", radius_mm = {RADIUS_PX * MM:.5f}, segments = 256'
    return text + f'[sample]\nshape = {{ {shape} }}\nshading = "smooth"\n'


def run(*words):
    start = time.time()
    done = subprocess.run([rig, *words], capture_output=True, text=True, check=True)
    print(f"rig {words[0]}: {time.time() - start:.0f} s", done.stderr.strip()[-200:], file=sys.stderr)
    return done.stdout


with tempfile.TemporaryDirectory() as folder:
    folder = Path(folder)
    (folder / "scene.toml").write_text(scene())
    frames = sorted(ball.glob("[0-9][0-9][0-9].png"))
    sensor = ["--gain", "1,1,1.5", "--read-noise", "35", "--black-level", "0"]
    images = run("merge", *frames, "--each", folder / "images", *sensor).split()
    words = ["--mask", ball / "mask.png", "--fit-lights", FITTED, "--json"]
    found = json.loads(run("validate", "--scene", folder / "scene.toml", "--image", *images, *words))

every = found["all"]
for region in ("overall", "away", "highlight"):
    row = every[region]
    values = {k: row[k] for k in ("relative_rms", "noise", "lambertian")}
    print(region, *(f"{k} {100 * v:.1f}%" for k, v in values.items()))
print(f"in 95% interval {100 * every['coverage']:.1f}%, half width {100 * every['median_half_width']:.0f}%")
peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
print(f"memory {peak / 1024:.0f} MB")
assert all(every[region]["relative_rms"] < most for region, most in MOST.items()), MOST
assert 0.9 < every["coverage"] < 0.98 and every["median_half_width"] < 1.1 * 0.079, every

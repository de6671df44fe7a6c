"""A telecentric camera above a sample, as rig and as Mitsuba are told of it."""

import subprocess
import sys

import mitsuba as mi

RIG = sys.argv[1]


def rig(*arguments):
    done = subprocess.run([RIG, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"rig {' '.join(map(str, arguments))} failed:\n{done.stderr}")
    return done.stdout


def camera(resolution):
    """The camera in a scene file."""
    return f"""[camera]
model = "orthographic"
resolution_px = [{resolution}, {resolution}]
extent_mm = [2.2, 2.2]
position_mm = [0.0, 0.0, 5.0]
look_at_mm = [0.0, 0.0, 0.0]
up = [0.0, 1.0, 0.0]
"""


def scene(resolution, to_light, reflections, sample):
    """The camera, a light and a sample as Mitsuba's scene."""
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0])
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": reflections + 1, "rr_depth": 1000},
        "sensor": {
            "type": "orthographic",
            "to_world": look @ mi.ScalarTransform4f().scale([1.1, 1.1, 1]),
            "film": {
                "type": "hdrfilm", "width": resolution, "height": resolution,
                "rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        },
        "light": {
            "type": "directional", "direction": [-x for x in to_light],
            "irradiance": {"type": "rgb", "value": 1.0},
        },
        "sample": sample,
    })  # fmt: skip

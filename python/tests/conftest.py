"""The program that the package is compared with, and what it makes for the tests.

The environment variable RIG names the program.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import rig_reflectometry as rig

SOURCE = Path(__file__).resolve().parents[2]

SCENE = """
[camera]
model = "orthographic"
resolution_px = [20, 16]
extent_mm = [21.0, 16.8]
position_mm = [0.0, 0.0, 100.0]

[[light]]
kind = "directional"
to_light = [0.5, 0.0, 0.8]

[[light]]
kind = "directional"
to_light = [-0.2, 0.3, 0.9]

[sample]
shape = { kind = "bowl", radius_mm = 10.0, segments = 64 }
shading = "smooth"

[brdf]
mixture = [
  { weight = [0.5, 0.3, 0.2], lambertian = { albedo = 1.0 } },
  { weight = 0.2, ggx = { alpha = 0.2, eta = 1.5 } },
  { weight = [0.3, 0.5, 0.6], black = {} },
]
"""


@pytest.fixture(scope="session")
def program():
    """Runs the program and returns what it prints."""
    path = os.environ.get("RIG")
    if path is None:
        pytest.fail("RIG is not set; it names the program that the package is compared with")
    path = str(Path(path).resolve(strict=True))

    def run(*arguments, folder=None):
        command = [path, *map(str, arguments)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        return done.stdout

    return run


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="session")
def scene(scene_file):
    return rig.Scene.load(scene_file)


@pytest.fixture(scope="session")
def images(scene):
    """Two images of the scene, 20 x 16 pixels."""
    return scene.render(spp=64)


@pytest.fixture(scope="session")
def quick_fit(scene, images):
    return rig.fit(scene, images, **QUICK)


QUICK = {"dictionary": "paper42", "spp": 32, "cells": 100, "max_reflections": 4}
QUICK_ARGUMENTS = "--dictionary paper42 --spp 32 --cells 100 --max-reflections 4".split()


@pytest.fixture(scope="session")
def captured(program, tmp_path_factory):
    """A session of two lights from the small simulated bench, without a fit."""
    folder = tmp_path_factory.mktemp("bench")
    bench, simulation = (SOURCE / "rig-configs/simulated.toml").read_text().split("[simulation]")
    for key, small in {
        "resolution_px": "[64, 64]",
        "extent_mm": "[22.0, 22.0]",
        "point_spread_px": "0.0",
    }.items():
        bench = re.sub(rf"(?m)^{key} = .*?(  #.*)?$", f"{key} = {small}", bench, count=1)
    for key, quick in {
        "samples_per_pixel": "2",
        "max_reflections": "2",
        "segments": "32",
        "timing": '"instant"',
    }.items():
        simulation = re.sub(rf"(?m)^{key} = .*$", f"{key} = {quick}", simulation, count=1)
    material = "brdf = { mixture = [ { weight = 1.0, lambertian = { albedo = 0.8 } } ] }"
    simulation = re.sub(r"(?m)^material = .*$", material, simulation, count=1)
    (folder / "rig.toml").write_text(f"{bench}[simulation]{simulation}")
    records = SOURCE / "tests/support/small_bench/calibration"
    shutil.copytree(records, folder / "calibration/simulated")
    capture = "capture --rig rig.toml --lights 2 --no-fit --sample cup".split()
    printed = program(*capture, folder=folder)
    return folder / printed.splitlines()[-1]


@pytest.fixture
def session_folder(captured, tmp_path):
    """A session of its own."""
    return Path(shutil.copytree(captured, tmp_path / "session"))

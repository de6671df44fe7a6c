"""Brackets: the program's image."""

import json

import numpy as np
from conftest import SOURCE

import rig_reflectometry as rig

FRAMES = SOURCE / "tests/outside/frames/usual-tiffs/deflate"


def test_merges_are_those_of_the_program(program, tmp_path):
    sensor = "--gain 0.5 --read-noise 2 --black-level 64 --bit-depth 12 --json".split()
    report = json.loads(program("merge", FRAMES, *sensor, "--out", tmp_path / "m.exr"))
    expected = rig.RadianceImage.load(tmp_path / "m.exr")
    phases = []
    merged = rig.merge(
        FRAMES,
        gain=0.5,
        read_noise=2,
        black_level=64,
        bit_depth=12,
        progress=lambda phase, done, total: phases.append((phase, done, total)),
    )
    for field in ["mean", "variance", "valid"]:
        assert np.array_equal(getattr(merged.image, field), getattr(expected, field))
    assert merged.agreement == report["channels"]
    assert merged.masked_pixels == report["masked_pixels"]
    rows = len(merged.image.mean)
    assert phases[0] == ("reading frames", 0, 3) and phases[-1] == ("merging", rows, rows)
    # By single files, kept where it was asked for.
    files = sorted(FRAMES.glob("*.tif"))
    sensor = {"gain": 0.5, "read_noise": 2, "black_level": 64, "bit_depth": 12}
    rig.merge(files, **sensor, out=tmp_path / "kept.exr")
    assert (tmp_path / "kept.exr").read_bytes() == (tmp_path / "m.exr").read_bytes()

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
    assert merged.exposures == report["measured_exposures"] == []
    # By single files, kept where it was asked for.
    files = sorted(FRAMES.glob("*.tif"))
    sensor = {"gain": 0.5, "read_noise": 2, "black_level": 64, "bit_depth": 12}
    rig.merge(files, **sensor, out=tmp_path / "kept.exr")
    assert (tmp_path / "kept.exr").read_bytes() == (tmp_path / "m.exr").read_bytes()


def test_exposures_that_the_frames_show_are_those_of_the_program(program, tmp_path):
    # One stated 20% too long.
    exposures = tmp_path / "exposures.csv"
    files = sorted(FRAMES.glob("*.tif"))
    stated = [0.02, 0.048, 0.08]
    exposures.write_text("".join(f"{f},{s}\n" for f, s in zip(files, stated, strict=True)))
    sensor = "--gain 0.5 --read-noise 2 --black-level 64 --bit-depth 12 --json".split()
    options = ["--measured-exposures", "--exposures", exposures, "--out", tmp_path / "m.exr"]
    report = json.loads(program("merge", FRAMES, *sensor, *options))
    sensor = {"gain": 0.5, "read_noise": 2, "black_level": 64, "bit_depth": 12}
    merged = rig.merge(FRAMES, **sensor, exposures=exposures, measured_exposures=True)
    assert merged.exposures == report["measured_exposures"]
    assert [used["stated_s"] for used in merged.exposures] == sorted(stated)
    expected = rig.RadianceImage.load(tmp_path / "m.exr")
    assert np.array_equal(merged.image.mean, expected.mean)

"""Sessions that the program captured."""

import numpy as np
import pytest
from conftest import QUICK, QUICK_ARGUMENTS

import rig_reflectometry as rig


def test_what_was_captured_is_there(session_folder):
    session = rig.Session(session_folder)
    assert (session.sample, session.simulated, session.complete) == ("cup", True, True)
    assert session.lights_deg.shape == (2, 2)
    frames = session.frames
    assert {frame.light for frame in frames} == {0, 1}
    assert {frame.kind for frame in frames} >= {"light"}
    counts, taken = session.read_frame(frames[0])
    assert (counts.shape, counts.dtype) == ((64, 64), np.uint16)
    assert taken["applied"]["exposure"] > 0 and counts.max() > taken["black_level_dn"]
    image = session.radiance(1)
    assert image.mean.shape == (64, 64, 3) and (image.variance[image.valid] > 0).all()
    with pytest.raises(rig.NoFitError):
        session.latest_fit
    assert session.fits == []


def test_fits_are_those_of_the_program(program, session_folder, tmp_path):
    session = rig.Session(session_folder)
    phases = []
    ours = session.fit(**QUICK, progress=lambda phase, done, total: phases.append(phase))
    assert "tracing paths" in phases and ours.simulated
    program("fit", session_folder, *QUICK_ARGUMENTS)
    _, theirs = session.fits
    assert np.array_equal(ours.weights, theirs.weights)
    assert np.array_equal(ours.table.lower, theirs.table.lower)
    assert ours.record["score"] == theirs.record["score"]
    assert np.array_equal(ours.rendered()[1].mean, theirs.rendered()[1].mean)
    assert np.array_equal(rig.Fit.load(session_folder / "fits/1").weights, ours.weights)
    # How it was measured is stated as well.
    assert ours.export(tmp_path / "ours.json", "birdf") == [tmp_path / "ours.json"]
    export = ["--fit", 0, "--format", "birdf", "--out", tmp_path / "theirs.json"]
    program("export", session_folder, *export)
    assert (tmp_path / "ours.json").read_bytes() == (tmp_path / "theirs.json").read_bytes()
    # The session is still whole.
    program("session", "verify", session_folder)


def test_damage_is_refused(session_folder):
    image = session_folder / "derived/radiance_L000.exr"
    data = bytearray(image.read_bytes())
    data[len(data) // 2] ^= 1
    image.write_bytes(data)
    session = rig.Session(session_folder)
    with pytest.raises(rig.SessionError, match="SHA-256"):
        session.radiance(0)
    with pytest.raises(rig.SessionError, match="SHA-256"):
        session.fit(**QUICK)
    assert session.fits == []

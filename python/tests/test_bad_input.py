"""What cannot be used becomes an exception of a documented kind, never a panic."""

import numpy as np
import pytest
from conftest import QUICK, SCENE

import rig_reflectometry as rig

UP = [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("wi", "wo", "said"),
    [
        ([1, 0], UP, r"wi has shape \(2,\), but must be \(…, 3\)"),
        (1.0, UP, r"wi has shape \(\)"),
        (np.tile(UP, (2, 1)), np.tile(UP, (3, 1)), "don't broadcast"),
        ([np.nan, 0, 1], UP, "vector 0 of wi is"),
        ([UP, [0, 0, 2]], UP, "vector 1 of wi is .*, of length 2; unit vectors"),
        ([0, 0, np.inf], UP, "unit vectors"),
        (["a", "b", "c"], UP, "wi is of type"),
        ([1j, 0, 0], UP, "complex128; real numbers"),
        ([[1], [1, 2]], UP, "wi is no array"),
        (None, UP, "wi is of type object"),
    ],
)
def test_directions(wi, wo, said):
    with pytest.raises(rig.InputError, match=said) as raised:
        rig.Brdf.load("ggx:0.2,1.5")(wi, wo)
    assert isinstance(raised.value, ValueError) and isinstance(raised.value, rig.RigError)


@pytest.mark.parametrize(
    ("spec", "kind", "said"),
    [
        ("nbrdf:gold", rig.InputError, "gold"),
        ("nothing", rig.InputError, "known"),
        ("ggx:3,1.5", rig.InputError, "alpha"),
        ("missing.binary", rig.MissingFileError, "missing.binary"),
        ("missing.bsdf", FileNotFoundError, "missing.bsdf"),
        ("paper42:missing.csv", OSError, "missing.csv"),
    ],
)
def test_brdfs(spec, kind, said):
    with pytest.raises(kind, match=said):
        rig.Brdf.load(spec)


def test_files_that_hold_something_else(tmp_path):
    for name in ["a.binary", "a.bsdf"]:
        (tmp_path / name).write_bytes(b"something else")
        with pytest.raises(rig.InputError, match=name):
            rig.Brdf.load(tmp_path / name)
    (tmp_path / "a.exr").write_bytes(b"something else")
    with pytest.raises(rig.FileError, match="not a readable OpenEXR file"):
        rig.RadianceImage.load(tmp_path / "a.exr")
    with pytest.raises(rig.NoFitError, match="holds no fit"):
        rig.Fit.load(tmp_path)
    with pytest.raises(LookupError):
        rig.Brdf.load(tmp_path)
    with pytest.raises(rig.SessionError):
        rig.Session(tmp_path)


def test_mixtures_and_angles():
    atoms = [rig.Atom("lambertian", albedo=1.0), rig.Atom("black")]
    for weights, said in [
        ([0.5, 0.6], "sum to 1.1"),
        ([1.0], r"\(1,\), but must be \(2,\) or \(3, 2\)"),
        ([np.nan, 1.0], "NaN"),
    ]:
        with pytest.raises(rig.InputError, match=said):
            rig.Brdf.mixture(atoms, weights)
    with pytest.raises(rig.InputError, match="unknown kind"):
        rig.Brdf.mixture([rig.Atom("velvet")], [1.0])
    brdf = rig.Brdf.mixture(atoms, [0.5, 0.5])
    with pytest.raises(rig.InputError, match="theta_i_deg has 95"):
        brdf.at(95, 0, 0)
    with pytest.raises(rig.InputError, match="theta_h_deg has NaN"):
        brdf.table([np.nan], [0])
    with pytest.raises(rig.InputError, match="no environment map \"moon\"; known: city"):
        brdf.environment_sphere("moon")
    with pytest.raises(rig.InputError, match="size is 4"):
        brdf.spheres(4)
    with pytest.raises(rig.InputError, match="neither in .binary nor"):
        brdf.save("brdf.png")
    with pytest.raises(rig.MissingFileError):
        brdf.save("no/such/folder/brdf.binary")


def test_scenes(tmp_path, scene):
    with pytest.raises(rig.MissingFileError):
        rig.Scene.load(tmp_path / "scene.toml")
    with pytest.raises(rig.SceneError, match=r"scene:\d+: unknown key `sample.colour`"):
        rig.Scene.parse(SCENE.replace("[sample]", "[sample]\ncolour = 1"))
    without = SCENE[: SCENE.index("[brdf]")]
    with pytest.raises(rig.InputError, match="no .brdf. table"):
        rig.Scene.parse(without).render()
    for choice in [{"samples_per_pixel": 1}, {"max_reflections": 65}]:
        with pytest.raises(rig.InputError, match="must be from"):
            scene.render(**choice)
    with pytest.raises(rig.InputError):
        scene.render(rig.Brdf.load("nbrdf:red-plastic"), polarised=True)


def changed(images, **fields):
    first = images[0]
    fields = {"mean": first.mean, "variance": first.variance, "valid": first.valid} | fields
    return [rig.RadianceImage(**fields), images[1]]


def test_images(scene, images):
    nan = images[0].mean.copy()
    nan[5, 6, 1] = np.nan
    negative = images[0].variance.copy()
    negative[5, 6, 1] = -1
    cases = [
        (changed(images, mean=nan), "images.0.: mean is NaN at row 5, column 6"),
        (changed(images, variance=negative), "variance is -1 at row 5, column 6"),
        (changed(images, mean=images[0].mean[:8]), "variance is of 16 × 20 pixels, but the means"),
        (changed(images, valid=np.ones((16, 20))), "valid must be of type bool"),
        ([images[0].mean[..., 0, 0], images[1]], r"mean has shape \(16,\)"),
        ([np.zeros((0, 20, 3)), images[1]], "0 × 20 pixels"),
        ([images[0].mean.astype(complex), images[1]], "real numbers"),
        ([object(), images[1]], "of type object"),
        (images[:1], "1 images for 2 lights"),
        ([images[0].mean[:8], images[1].mean], "image 0 is 20 × 8"),
        ("image.exr", "a list of them is needed"),
    ]
    for bad, said in cases:
        with pytest.raises(rig.InputError, match=said):
            rig.fit(scene, bad, **QUICK)
    # A pixel that is not valid may hold anything.
    valid = np.ones((16, 20), bool)
    valid[5, 6] = False
    assert rig.fit(scene, changed(images, mean=nan, valid=valid), **QUICK).loss > 0
    with pytest.raises(rig.FitError):
        rig.fit(scene, [np.zeros((16, 20, 3))] * 2, **QUICK)


def test_choices_of_a_fit(scene, images, tmp_path):
    for choice, kind, said in [
        ({"samples_per_cell": 1}, rig.InputError, "samples_per_cell is 1, but must be from 2"),
        ({"model_error": 2.0}, rig.InputError, "model_error is 2"),
        ({"optimizer": "adam"}, rig.InputError, "gauss-newton"),
        ({"kernel": "neon"}, rig.InputError, "portable"),
        ({"dictionary": "merl"}, rig.InputError, "merl"),
        ({"uncertainty": {"light": 1}}, rig.InputError, "unknown key light"),
        ({"uncertainty": {"light_deg": 1}}, rig.InputError, "not refined"),
        ({"mask": tmp_path / "no.png"}, rig.InputError, "no.png"),
        ({"spp": 16}, TypeError, "unexpected keyword argument 'spp'"),
        ({"seed": "one"}, TypeError, "argument 'seed'"),
        ({"memory_mib": 16, "samples_per_cell": 65536, "cells": 40000}, rig.FitError, "memory|MiB"),
    ]:
        with pytest.raises(kind, match=said):
            rig.fit(scene, images, **choice)
    with pytest.raises(rig.MissingFileError):
        rig.fit(scene, [tmp_path / "no.exr"])
    with pytest.raises(rig.InputError, match="scene is a int"):
        rig.fit(3, images)
    (tmp_path / "full").mkdir()
    (tmp_path / "full/file").touch()
    with pytest.raises(rig.FileError, match="not empty"):
        rig.fit(scene, images, out=tmp_path / "full")


def test_brackets(tmp_path):
    with pytest.raises(rig.FileError):
        rig.merge([tmp_path / "no.png"], gain=1, read_noise=1, black_level=0)
    with pytest.raises(rig.InputError):
        rig.merge(tmp_path, gain=1, read_noise=1, black_level=0)
    with pytest.raises(rig.InputError):
        rig.merge([])
    with pytest.raises(rig.InputError, match="mosaic is \"rgb\""):
        rig.merge([], mosaic="rgb")

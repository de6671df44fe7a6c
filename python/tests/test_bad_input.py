"""What cannot be used becomes an exception of a documented kind, never a panic."""

import errno
import os
import pickle

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
        ("nbrdf:gold", rig.InputError, 'no embedded material "gold"; known are .*red-plastic'),
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


HUGE = 10**400


@pytest.mark.parametrize("number", [-1, -HUGE, HUGE, 2**64])
def test_numbers_out_of_range(number, scene, images, session_folder):
    brdf, session = rig.Brdf.load("ggx:0.2,1.5"), rig.Session(session_folder)
    for name, call in {
        "light": lambda: session.radiance(number),
        "size": lambda: brdf.spheres(number),
        "samples_per_pixel": lambda: scene.render(samples_per_pixel=number),
        "max_reflections": lambda: scene.render(max_reflections=number),
        "seed": lambda: scene.render(seed=number),
        "cells": lambda: rig.fit(scene, images, cells=number),
        "memory_mib": lambda: session.fit(memory_mib=number),
        "model_error": lambda: session.fit(model_error=number),
        "bit_depth": lambda: rig.merge([], bit_depth=number),
    }.items():
        with pytest.raises(rig.InputError, match=f"{name} is .*, but must be from [0-9]+ to [0-9]+"):
            call()
    with pytest.raises(rig.InputError, match="seed is .*, but must be from 0 to"):
        session.fit(seed=number)
    for other in ({"seed": "one"}, {"samples_per_pixel": 2.5}):
        with pytest.raises(TypeError):
            scene.render(**other)


def test_results_that_memory_cannot_hold(scene):
    brdf = rig.Brdf.load("ggx:0.2,1.5")
    many = np.zeros(10**6)
    up = np.array(UP)
    directions = np.broadcast_to(up, (10**6, 1, 3)), np.broadcast_to(up, (1, 10**6, 3))
    image = np.broadcast_to(np.float32(1), (65536, 65536, 3))
    light = "[[light]]\nkind = \"directional\"\nto_light = [0.1, 0.2, 0.9]\n"
    large = SCENE.replace("[20, 16]", "[16384, 16384]").replace("[sample]", 500 * light + "[sample]")
    for call in (
        lambda: brdf.at(many[:, None], many[None, :], 0),
        lambda: brdf(*directions),
        lambda: brdf.table(many, many),
        lambda: brdf.table(np.broadcast_to(0.0, 10**13), [0]),
        lambda: rig.fit(scene, [image, image]),
        lambda: rig.Scene.parse(large).render(),
    ):
        with pytest.raises(MemoryError, match="GiB are needed"):
            call()


def test_scenes(tmp_path, scene):
    with pytest.raises(rig.MissingFileError):
        rig.Scene.load(tmp_path / "scene.toml")
    with pytest.raises(rig.SceneError, match=r"scene:\d+: unknown key `sample.colour`"):
        rig.Scene.parse(SCENE.replace("[sample]", "[sample]\ncolour = 1"))
    without = SCENE[: SCENE.index("[brdf]")]
    with pytest.raises(rig.InputError, match="no .brdf. table"):
        rig.Scene.parse(without).render()
    for choice in [{"spp": 1}, {"samples_per_pixel": 1}, {"max_reflections": 65}]:
        with pytest.raises(rig.InputError, match="must be from"):
            scene.render(**choice)
    with pytest.raises(TypeError, match="both 'spp' and 'samples_per_pixel'"):
        scene.render(spp=2, samples_per_pixel=2)
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
        ([images[0].mean[:8], images[1].mean], "image 1 is 20 × 8"),
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


def test_masked_arrays(scene, images, tmp_path):
    masked = np.ma.array(np.ones((8, 8, 3), np.float32))
    masked[0, 0] = 777
    masked[0, 0] = np.ma.masked
    masked[3, 4, 1] = np.ma.masked
    no_information = [[0, 0], [3, 4]]
    for image in (
        rig.RadianceImage(masked),
        rig.RadianceImage(np.ones((8, 8, 3)), variance=masked),
        rig.RadianceImage(np.ones((8, 8, 3)), valid=np.ma.array(np.ones((8, 8), bool), mask=masked.mask.any(-1))),
    ):
        image.save(tmp_path / "image.exr")
        back = rig.RadianceImage.load(tmp_path / "image.exr")
        assert np.argwhere(~back.valid).tolist() == no_information
        assert not back.mean[0, 0].any()
    # In a fit they count as little.
    nan = np.ma.masked_invalid(np.where(np.arange(20)[:, None] == 6, np.nan, images[0].mean))
    assert rig.fit(scene, [nan, images[1].mean], **QUICK).loss > 0
    directions = np.ma.array([UP, UP], mask=[[0, 0, 0], [1, 1, 1]])
    with pytest.raises(rig.InputError, match="wi has masked values"):
        rig.Brdf.load("ggx:0.2,1.5")(directions, UP)
    with pytest.raises(rig.InputError, match="theta_h_deg has masked values"):
        rig.Brdf.load("ggx:0.2,1.5").table(np.ma.masked_greater([10.0, 95.0], 90), [0])


def test_what_the_system_says(tmp_path, scene):
    missing = tmp_path / "no"
    for call, file in [
        (lambda: rig.Scene.load(missing), missing),
        (lambda: rig.Brdf.load(f"{missing}.binary"), f"{missing}.binary"),
        (lambda: rig.RadianceImage.load(missing), missing),
        (lambda: rig.fit(scene, [missing, missing]), missing),
        (lambda: rig.Scene.parse(SCENE.replace('shape = { kind = "bowl", radius_mm = 10.0, segments = 64 }', f'mesh = "{missing}.ply"')).render(), f"{missing}.ply"),
    ]:
        with pytest.raises(rig.MissingFileError) as raised:
            call()
        error = raised.value
        assert (error.errno, error.filename) == (errno.ENOENT, str(file))
        assert error.strerror == os.strerror(errno.ENOENT)
        assert str(file) in str(error)
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again), again.errno) == (type(error), str(error), error.errno)
    with pytest.raises(rig.FileError) as raised:
        rig.RadianceImage.load(tmp_path)
    assert (raised.value.errno, raised.value.filename) == (errno.EISDIR, str(tmp_path))


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
        ({"spp": 1}, rig.InputError, "spp is 1, but must be from 2"),
        ({"leave_out": ["felt"]}, rig.InputError, 'leave_out names "felt"'),
        ({"spp": 16, "samples_per_cell": 16}, TypeError, "both 'spp' and 'samples_per_cell'"),
        ({"memory": 1}, rig.InputError, "memory is 1, but must be from 16"),
        ({"samples": 16}, TypeError, "unexpected keyword argument 'samples'"),
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

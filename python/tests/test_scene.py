"""Scenes from arrays: what a file would say, read back and rendered."""

from dataclasses import replace

import numpy as np
import pytest

import rig_reflectometry as rig

BOWL = {"kind": "bowl", "radius_mm": 10.0, "segments": 64}
CAMERA = rig.Camera(resolution_px=(20, 16), extent_mm=(21.0, 16.8), position_mm=(0.0, 0.0, 100.0))
LIGHTS = np.array([[0.5, 0.0, 0.8], [-0.2, 0.3, 0.9]])


def renders(scene, brdf):
    return np.array([image.mean for image in scene.render(brdf, spp=16)])


def test_arrays_make_the_scene_of_the_file(scene):
    made = rig.Scene(CAMERA, LIGHTS, BOWL, shading="smooth")
    expected = renders(scene, scene.brdf)
    assert np.array_equal(renders(made, scene.brdf), expected)
    # What is read of one makes another.
    for sample in [BOWL, scene.mesh]:
        again = rig.Scene(scene.camera, scene.lights, sample, shading=scene.shading)
        np.testing.assert_allclose(renders(again, scene.brdf), expected, rtol=1e-3, atol=1e-5)
    small = rig.Scene(replace(scene.camera, resolution_px=(10, 8)), LIGHTS[:1], scene.mesh)
    assert (small.shape, len(small.lights), small.shading) == ((8, 10), 1, "flat")


def test_everything_is_read_back(tmp_path):
    camera = replace(
        CAMERA,
        extent_mm=None,
        fov_deg=30.0,
        position_mm=[10.0, -20.0, 100.0],
        look_at_mm=np.array([1.0, 2.0, 3.0]),
        up=[0.0, 1.0, 1.0],
        object_na=0.01,
        focus_mm=90.0,
        point_spread_px=0.5,
        principal_point_px=[9.0, 8.5],
        pixel_aspect=1.1,
        radial=[0.01, 0.0, 0.0],
        tangential=[0.001, 0.0],
    )
    lights = [
        rig.Light(to_light=[0.0, 3.0, 4.0], irradiance=2.0, angular_radius_deg=0.5),
        rig.Light(position_mm=[0, 0, 300], intensity=[1e4, 2e4, 3e4]),
    ]
    grey = {"mixture": [{"weight": 1.0, "lambertian": {"albedo": 0.5}}]}
    holder = {"shape": BOWL | {"radius_mm": np.float32(12)}, "brdf": grey}
    scene = rig.Scene(camera, lights, BOWL, body=[holder], brdf=grey, uncertainty={"light_deg": 1})
    assert scene.brdf is not None and scene.shading == "flat"
    read = scene.camera
    for field in ("resolution_px position_mm fov_deg object_na focus_mm point_spread_px "
                  "principal_point_px pixel_aspect radial tangential").split():
        np.testing.assert_allclose(getattr(read, field), getattr(camera, field), err_msg=field)
    again = rig.Scene(read, scene.lights, BOWL).camera
    for field in ["look_at_mm", "up"]:
        np.testing.assert_allclose(getattr(again, field), getattr(read, field), atol=1e-12)
    sun, lamp = scene.lights
    np.testing.assert_allclose(sun.to_light, [0, 0.6, 0.8])
    assert (sun.irradiance.tolist(), lamp.intensity.tolist()) == ([2.0] * 3, [1e4, 2e4, 3e4])
    assert sun.angular_radius_deg == pytest.approx(0.5) and lamp.position_mm[2] == 300
    per_light = rig.Scene(CAMERA, LIGHTS, BOWL, irradiance=[[1], [2]]).lights
    assert [light.irradiance.tolist() for light in per_light] == [[1.0] * 3, [2.0] * 3]


def test_a_mesh_is_taken_as_it_is():
    mesh = rig.Mesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    scene = rig.Scene(CAMERA, [[0, 0, 1]], mesh, irradiance=np.pi)
    assert np.array_equal(scene.mesh.vertices_mm, mesh.vertices_mm)
    assert np.array_equal(scene.mesh.triangles, mesh.triangles) and scene.mesh.normals is None
    (image,) = scene.render(rig.Brdf.load("lambertian:0.5"), spp=16)
    np.testing.assert_allclose(image.mean[8, 10], 0.5, rtol=1e-5)
    smooth = rig.Scene(CAMERA, [[0, 0, 1]], mesh, shading="smooth").mesh.normals
    np.testing.assert_allclose(smooth, np.tile([0, 0, 1], (4, 1)))


@pytest.mark.parametrize(
    ("change", "kind", "said"),
    [
        ({"camera": replace(CAMERA, extent_mm=(-1, 1))}, rig.SceneError, "camera.extent_mm"),
        ({"camera": {"model": "orthographic"}}, TypeError, "a Camera is needed"),
        ({"lights": LIGHTS[0]}, rig.InputError, r"lights has shape \(3,\)"),
        ({"lights": [[0, 0, 0]]}, rig.SceneError, r"light\[0\].to_light"),
        ({"lights": [[0, 0, np.nan]]}, rig.SceneError, r"light\[0\].to_light"),
        ({"irradiance": [1, 2]}, rig.InputError, r"irradiance has shape \(2,\)"),
        ({"irradiance": -1}, rig.SceneError, "irradiance"),
        ({"lights": [rig.Light()], "irradiance": 1}, rig.InputError, "each Light has its own"),
        ({"lights": [rig.Light(), 3]}, TypeError, "a light is a int"),
        ({"sample": BOWL | {"colour": 1}}, rig.SceneError, "unknown key `sample.shape.colour`"),
        ({"sample": "no.ply"}, None, None),
        ({"sample": rig.Mesh(np.eye(3), [[0, 1, 3]])}, rig.InputError, "sample: .*vertex 3"),
        ({"sample": rig.Mesh(np.eye(3), [[0, 1, 0.5]])}, rig.InputError, "has 0.5, which is no"),
        ({"sample": rig.Mesh(np.eye(2), [[0, 1, 2]])}, rig.InputError, r"must be \(N, 3\)"),
        ({"shading": "soft"}, rig.SceneError, "sample.shading"),
        ({"sky": {}}, rig.SceneError, "unknown key `sky`"),
        ({"sample_": 3, "light": []}, TypeError, "light is not among"),
        ({"brdf": {"mixture": [object()]}}, TypeError, "no place for a object"),
    ],
)
def test_what_is_no_scene_is_refused(change, kind, said):
    given = {"camera": CAMERA, "lights": LIGHTS, "sample": BOWL} | change
    if kind is None:
        with pytest.raises(rig.MissingFileError):
            rig.Scene(**given).mesh
        return
    with pytest.raises(kind, match=said):
        rig.Scene(**given)

"""Scenes, renders and fits: the program's numbers, and their shapes."""

import csv

import numpy as np
import pytest
from conftest import QUICK, QUICK_ARGUMENTS

import rig_reflectometry as rig


def same_pixels(a, b):
    return np.array_equal(a.mean, b.mean) and np.array_equal(a.variance, b.variance)


def test_renders_are_those_of_the_program(program, scene, scene_file, images, tmp_path):
    assert (scene.shape, len(scene.lights)) == ((16, 20), 2)
    program("render", "--scene", scene_file, "--out", tmp_path / "i.exr", "--spp", 64)
    for light, image in enumerate(images):
        written = rig.RadianceImage.load(tmp_path / f"i_L{light:03}.exr")
        assert image.mean.shape == (16, 20, 3) and same_pixels(image, written)


def test_images_survive_a_file(images, tmp_path):
    valid = np.ones((16, 20), bool)
    valid[3, 4] = False
    masked = rig.RadianceImage(images[0].mean, images[0].variance, valid)
    masked.save(tmp_path / "i.exr")
    loaded = rig.RadianceImage.load(tmp_path / "i.exr")
    assert np.array_equal(loaded.valid, valid) and not loaded.mean[3, 4].any()
    assert np.array_equal(loaded.mean[valid], images[0].mean[valid])


def test_fits_are_those_of_the_program(program, scene_file, images, quick_fit, tmp_path):
    files = [tmp_path / f"{light}.exr" for light in range(2)]
    for image, file in zip(images, files, strict=True):
        image.save(file)
    out = tmp_path / "program"
    arguments = ["--scene", scene_file, "--image", *files, "--out", out, *QUICK_ARGUMENTS]
    program("fit", *arguments)
    quick_fit.save(tmp_path / "package")
    for name in ["weights.csv", "table.csv"]:
        assert (out / name).read_bytes() == (tmp_path / "package" / name).read_bytes()
    from_program = rig.Fit.load(out)
    assert np.array_equal(from_program.weights, quick_fit.weights)
    assert from_program.loss == quick_fit.loss
    assert (from_program.verdict, from_program.warnings) == (quick_fit.verdict, quick_fit.warnings)
    for ours, theirs in zip(quick_fit.rendered(), from_program.rendered(), strict=True):
        assert same_pixels(ours, theirs)
    # By files, without a variance, as the program reads them.
    bare = [tmp_path / f"bare-{light}.exr" for light in range(2)]
    for image, file in zip(images, bare, strict=True):
        write_without_variance(program, image, file)
    by_arrays = rig.fit(scene_file, [image.mean for image in images], **QUICK)
    assert any("no variance is stated" in remark for remark in by_arrays.remarks)
    by_files = rig.fit(scene_file, bare, **QUICK)
    assert np.array_equal(by_files.weights, by_arrays.weights)


def write_without_variance(program, image, file):
    """The means alone. The package always writes variances, so three channels are renamed."""
    image.save(file)
    data = file.read_bytes()
    for channel in [b"var.R", b"var.G", b"var.B"]:
        assert data.count(channel) == 1
        data = data.replace(channel, channel.replace(b"var", b"vac"))
    file.write_bytes(data)


def test_a_fit_has_arrays_of_the_stated_shapes(quick_fit):
    fit = quick_fit
    assert fit.dictionary == "paper42" and len(fit.atoms) == 42
    assert fit.weights.shape == fit.weight_deviations.shape == (3, 42)
    np.testing.assert_allclose(fit.weights.sum(axis=1), 1)
    table = fit.table
    assert table.value.shape == (46, 31, 3) and table.constrained.shape == (46, 31)
    assert (table.lower <= table.value).all() and (table.value <= table.upper).all()
    at_40 = fit.brdf.table(table.theta_h_deg[30:31], table.theta_d_deg[:5])
    np.testing.assert_allclose(at_40[0], table.value[30, :5], rtol=1e-3)
    budget = fit.budget
    assert budget.share.shape == (len(budget.value), len(budget.sources))
    np.testing.assert_allclose(budget.share.sum(axis=1), 1)
    assert fit.reduced_chi_square.shape == (2, 3) and fit.trace[-1] == fit.loss
    assert fit.record["settings"]["optimizer"] == "gauss-newton"
    assert fit.residual()[0].variance is None


def test_an_interval_is_the_tables_or_between_its_cells(quick_fit):
    table = quick_fit.table
    half, difference = table.theta_h_deg[[0, 12, 45]], table.theta_d_deg[[3, 30]]
    at_cells = quick_fit.interval(half[:, None], difference)
    for field in ["value", "lower", "upper", "constrained"]:
        of_table = getattr(table, field)[[0, 12, 45]][:, [3, 30]]
        assert np.array_equal(getattr(at_cells, field), of_table), field
    between = quick_fit.interval(15.0, [[10.0], [37.0]])
    assert (between.value.shape, between.constrained.shape) == ((2, 1, 3), (2, 1))
    assert (between.lower <= between.value).all() and (between.value <= between.upper).all()
    f = quick_fit.brdf.table([15.0], [10.0, 37.0])
    np.testing.assert_allclose(between.value[:, 0], f[0], rtol=1e-4)
    at_90, in_plane = quick_fit.interval(15.0, 37.0, [90.0, 0.0]).value
    assert np.array_equal(at_90, between.value[1, 0])
    np.testing.assert_allclose(in_plane, quick_fit.brdf.at(52.0, 22.0, 180.0), rtol=1e-4)
    # As wide as the cells around, relative to f.
    i, j = np.searchsorted(table.theta_h_deg, 15.0), np.searchsorted(table.theta_d_deg, 10.0)
    around = np.s_[i - 1 : i + 1, j - 1 : j + 1]
    width = table.upper[around] / table.value[around]
    own = between.upper[0, 0] / between.value[0, 0]
    assert (width.min((0, 1)) <= own).all() and (own <= width.max((0, 1))).all()
    for bad, said in [((95, 0), "theta_h_deg has 95"), (([1, 2], [1, 2, 3]), "don't broadcast")]:
        with pytest.raises(rig.InputError, match=said):
            quick_fit.interval(*bad)


def test_deviations_are_those_of_the_program(program, scene, scene_file, quick_fit, tmp_path):
    quick_fit.save(tmp_path / "fit")
    options = ["--deviation", tmp_path / "d.exr", "--out", tmp_path / "i.exr", "--spp", 2]
    program("render", "--scene", scene_file, "--fit", tmp_path / "fit", *options)
    seen = []
    ours = quick_fit.deviations(scene, progress=lambda *report: seen.append(report))
    for light, deviation in enumerate(ours):
        written = rig.RadianceImage.load(tmp_path / f"d_L{light:03}.exr")
        assert deviation.any() and np.array_equal(deviation, written.mean)
    assert seen[0] == ("rendering", 0, 16 * 32) and seen[-1] == ("rendering", 16 * 32, 16 * 32)


def test_a_fit_is_found_in_its_folder_and_written_once(quick_fit, tmp_path):
    quick_fit.save(tmp_path / "fit")
    table = (tmp_path / "fit/table.csv").read_text().splitlines()
    row = next(csv.DictReader(table))
    assert float(row["f_r"]) == quick_fit.table.value[0, 0, 0]
    with pytest.raises(rig.FileError, match="not empty"):
        quick_fit.save(tmp_path / "fit")
    wi = [0.6, 0, 0.8]
    assert np.array_equal(rig.Brdf.load(tmp_path / "fit")(wi, wi), quick_fit.brdf(wi, wi))


def test_exports_are_those_of_the_program(program, quick_fit, tmp_path):
    quick_fit.save(tmp_path / "fit")
    for format, ending in [("json", "json"), ("mitsuba", "xml")]:
        ours, theirs = tmp_path / f"ours.{ending}", tmp_path / f"theirs.{ending}"
        assert list(map(str, quick_fit.export(ours, format))) == [str(ours)]
        program("export", tmp_path / "fit", "--format", format, "--out", theirs)
        assert ours.read_bytes() == theirs.read_bytes()
    with pytest.raises(rig.InputError, match="birdf needs the session of the fit"):
        quick_fit.export(tmp_path / "x.json", "birdf")
    with pytest.raises(rig.InputError, match='"obj", but must be one of json, merl, '):
        quick_fit.export(tmp_path / "x.obj", "obj")

"""What records show of themselves, and as pandas' tables."""

import sys

import numpy as np
import pytest

import rig_reflectometry as rig


def test_what_is_shown_is_short(images, quick_fit):
    plastic = rig.Brdf.load("nbrdf:red-plastic")
    valid = np.ones((16, 20), bool)
    valid[3, 4] = False
    sphere = rig.Mesh(np.eye(3), [[0, 1, 2]])
    errors = plastic.errors(rig.Brdf.load("ggx:0.2,1.5"), size=16)
    for thing, said in [
        (images[0], "RadianceImage(20 x 16 px, with variance)"),
        (rig.RadianceImage(images[0].mean, valid=valid), "without variance, 1 px not valid"),
        (quick_fit.table, "Table(46 half x 31 difference angles, "),
        (quick_fit.budget, "pairs of angles, sources: "),
        (errors, f"Errors(environment={errors.environment.all:.3g}, brdf="),
        (errors.brdf, f"PerChannel(all={errors.brdf.all:.3g}, red="),
        (plastic.check(), "Check(passes=True, reciprocity="),
        (rig.Merged(images[0], 3, [], []), "Merged(RadianceImage(20 x 16 px, with variance), masked"),
        (sphere, "Mesh(3 vertices, 1 triangles)"),
        (quick_fit.interval(15, [10, 50]), "Interval(2 pairs of angles, "),
        (quick_fit.interval(15, 10), "], constrained="),
        (rig.Light(to_light=(0, 0, 1)), "Light(to_light=[0, 0, 1])"),
    ]:
        assert said in repr(thing) and len(repr(thing)) < 200, repr(thing)


def test_tables_become_those_of_pandas(quick_fit, tmp_path):
    pandas = pytest.importorskip("pandas", reason="an optional dependency")
    quick_fit.save(tmp_path / "fit")
    written = pandas.read_csv(tmp_path / "fit/table.csv")
    pandas.testing.assert_frame_equal(quick_fit.table.to_pandas(), written)
    budget = quick_fit.budget.to_pandas()
    assert len(budget) == len(quick_fit.budget.value)
    np.testing.assert_allclose(budget[quick_fit.budget.sources].sum(axis=1), 1)
    exact = quick_fit.budget.not_evaluated
    assert "pose" in exact and "model" not in exact and budget[exact].isna().all(axis=None)


def test_without_pandas_it_is_named(quick_fit, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    for table in [quick_fit.table, quick_fit.budget]:
        with pytest.raises(ImportError, match="needs the package pandas"):
            table.to_pandas()

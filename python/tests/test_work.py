"""Long work and other processes: interrupted, followed, sent; forks are refused."""

import io
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import types

import numpy as np
import pytest
from conftest import QUICK

import rig_reflectometry as rig


def long(scene, **options):
    """Work of a minute."""
    return scene.render(spp=50_000, **options)


def test_ctrl_c_ends_work(scene):
    begun = threading.Event()

    def interrupt():
        begun.wait()
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        long(scene, progress=lambda *_: begun.set())


def test_ctrl_c_ends_a_fit_and_nothing_is_written(scene, images, tmp_path):
    def progress(phase, done, total):
        if phase == "tracing paths":
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        rig.fit(scene, images, samples_per_cell=65_536, out=tmp_path / "fit", progress=progress)
    assert list(tmp_path.iterdir()) == []


def test_what_progress_raises_ends_work(scene):
    class Enough(Exception):
        pass

    def progress(phase, done, total):
        assert (phase, total) == ("rendering", 16)
        raise Enough

    with pytest.raises(Enough):
        long(scene, progress=progress)
    with pytest.raises(TypeError):
        long(scene, progress=3)


def test_progress_counts_rows_on_the_calling_thread(scene):
    seen = []

    def progress(*report):
        assert threading.current_thread() is threading.main_thread()
        seen.append(report)

    scene.render(spp=2, progress=progress)
    assert seen == [("rendering", done, 16) for done in range(17)]


def test_other_threads_run_meanwhile(scene):
    rounds, stop = 0, False

    def count():
        nonlocal rounds
        while not stop:
            rounds += 1
            time.sleep(0)

    counter = threading.Thread(target=count)

    def progress(*_):
        if rounds > 100:
            raise KeyboardInterrupt

    counter.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            scene.render(spp=2000, progress=progress)
    finally:
        stop = True
        counter.join()
    assert rounds > 100


def evaluate(spec):
    return float(rig.Brdf.load(spec).spheres(8).sum())


def refused(spec):
    try:
        return evaluate(spec)
    except RuntimeError as error:
        return str(error)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_spawned_processes_work_and_forked_ones_are_refused():
    own = evaluate("ggx:0.2,1.5")
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(evaluate, ["ggx:0.2,1.5"]) == [own]
    with multiprocessing.get_context("fork").Pool(1) as pool:
        (said,) = pool.map_async(refused, ["ggx:0.2,1.5"]).get(timeout=60)
    assert "forked" in said and "spawn" in said


def same_brdf(a, b):
    wi, wo = [0.6, 0.0, 0.8], [-0.28, 0.0, 0.96]
    return a.name == b.name and np.array_equal(a(wi, wo), b(wi, wo))


def test_what_is_made_of_names_files_and_arrays_can_be_sent(scene, images, tmp_path):
    atoms = [rig.Atom("ggx", alpha=0.2, eta=1.5), rig.Atom("lambertian", albedo=1.0)]
    file = tmp_path / "table.binary"
    rig.Brdf.load("ggx:0.3,1.5").save(file)
    for brdf in [
        rig.Brdf.load("nbrdf:red-plastic"),
        rig.Brdf.load("ggx:0.1,1.5"),
        rig.Brdf.mixture(atoms, [[0.1, 0.9], [0.2, 0.8], [0.3, 0.7]], name="mine"),
        rig.Brdf.load(file),
        scene.brdf,
    ]:
        assert same_brdf(pickle.loads(pickle.dumps(brdf)), brdf), brdf
    again = pickle.loads(pickle.dumps(scene))
    assert repr(again) == repr(scene)
    assert np.array_equal(again.render(spp=64)[0].mean, images[0].mean)
    made = rig.Scene(scene.camera, scene.lights, scene.mesh, shading="smooth")
    again = pickle.loads(pickle.dumps(made))
    assert np.array_equal(again.mesh.vertices_mm, made.mesh.vertices_mm)
    assert np.array_equal(pickle.loads(pickle.dumps(images[1])).mean, images[1].mean)


def test_fits_and_sessions_can_be_sent(quick_fit, session_folder):
    again = pickle.loads(pickle.dumps(quick_fit))
    assert same_brdf(again.brdf, quick_fit.brdf) and repr(again) == repr(quick_fit)
    assert again.record == quick_fit.record
    for field in ["value", "lower", "upper", "constrained"]:
        assert np.array_equal(getattr(again.table, field), getattr(quick_fit.table, field))
    assert np.array_equal(again.residual()[1].mean, quick_fit.residual()[1].mean)
    assert same_brdf(pickle.loads(pickle.dumps(quick_fit.brdf)), quick_fit.brdf)
    session = rig.Session(session_folder)
    assert pickle.loads(pickle.dumps(session)).path == session_folder


class Bar:
    """What a bar of tqdm was told."""

    made = []

    def __init__(self, total, **options):
        self.n, self.total, self.phases, self.resets = 0, total, [], 0
        Bar.made.append(self)

    def update(self, steps):
        assert steps >= 0
        self.n += steps

    def reset(self):
        self.n, self.resets = 0, self.resets + 1

    def set_description_str(self, phase):
        self.phases.append(phase)

    def close(self):
        pass


@pytest.fixture
def bars(monkeypatch):
    monkeypatch.setattr(Bar, "made", [])
    monkeypatch.setitem(sys.modules, "tqdm", types.ModuleType("tqdm"))
    monkeypatch.setitem(sys.modules, "tqdm.auto", types.SimpleNamespace(tqdm=Bar))
    return Bar.made


@pytest.mark.parametrize("dictionary", ["rig26", "rig65"])
def test_a_fit_is_one_bar_that_comes_to_its_end(scene, images, bars, dictionary):
    options = QUICK | {"dictionary": dictionary, "spp": 8}
    rig.fit(scene, images, **options, progress=rig.ProgressBar())
    (bar,) = bars
    assert (bar.n, bar.total, bar.resets) == (1000, 1000, 0)
    assert bar.phases[0] == "direct reflection" and "uncertainty" in bar.phases


def test_other_work_is_one_bar_as_well(scene, bars):
    with rig.ProgressBar() as bar:
        scene.render(spp=2, progress=bar)
        assert (bars[0].n, bars[0].total) == (16, 16)
    with rig.ProgressBar() as bar:
        for report in [("reading", 0, 3), ("reading", 3, 3), ("merging", 0, 9), ("merging", 9, 9)]:
            bar(*report)
    assert len(bars) == 2 and (bars[1].n, bars[1].total, bars[1].resets) == (9, 9, 1)


def test_a_bar_of_tqdm_follows(scene):
    pytest.importorskip("tqdm", reason="an optional dependency")
    for options in [{"disable": True}, {"file": io.StringIO()}]:
        with rig.ProgressBar(**options) as bar:
            scene.render(spp=2, progress=bar)
    assert "rendering" in options["file"].getvalue()

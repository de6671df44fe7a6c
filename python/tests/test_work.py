"""Long work: the interpreter goes on, Ctrl-C and callbacks end it, forks are refused."""

import multiprocessing
import os
import signal
import threading
import time

import pytest

import rig_reflectometry as rig


def long(scene, **options):
    """Work of a minute."""
    return scene.render(samples_per_pixel=50_000, **options)


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

    scene.render(samples_per_pixel=2, progress=progress)
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
            scene.render(samples_per_pixel=2000, progress=progress)
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


def test_a_bar_follows(scene):
    tqdm = pytest.importorskip("tqdm", reason="an optional dependency")
    assert tqdm
    with rig.ProgressBar(disable=True) as bar:
        scene.render(samples_per_pixel=2, progress=bar)

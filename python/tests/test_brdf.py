"""BRDFs: the program's numbers, arrays of any shape, mixtures, files."""

import csv
import io
import json

import numpy as np
import pytest

import rig_reflectometry as rig

# One of each kind of name; files are made from them.
SPECS = ["nbrdf:red-plastic", "ggx:0.1,1.5", "lambertian:0.5"]


def directions(theta_deg, phi_deg):
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def evaluated_by(program, spec, angles, folder):
    table = folder / "angles.csv"
    lines = (",".join(map(str, row)) for row in angles)
    table.write_text("theta_i_deg,theta_o_deg,phi_deg\n" + "\n".join(lines))
    printed = program("brdf", "eval", "--brdf", spec, "--angles", table)
    rows = csv.DictReader(io.StringIO(printed))
    return np.array([[r["f_r"], r["f_g"], r["f_b"]] for r in rows]).astype(np.float32)


@pytest.mark.parametrize("spec", SPECS)
def test_values_are_those_of_the_program(program, spec, tmp_path):
    random = np.random.default_rng(1)
    angles = np.column_stack([random.uniform(0, 90, (50, 2)), random.uniform(0, 360, 50)])
    angles[0] = [30, 30, 180]
    expected = evaluated_by(program, spec, angles, tmp_path)
    brdf = rig.Brdf.load(spec)
    assert np.array_equal(brdf.at(*angles.T), expected)
    # The same by directions, whose sines and cosines are NumPy's: to rounding.
    wi, wo = directions(angles[:, 0], 0.0), directions(angles[:, 1], angles[:, 2])
    np.testing.assert_allclose(brdf(wi, wo), expected, rtol=2e-3, atol=1e-6)


def test_all_materials_are_there():
    names = rig.materials()
    assert len(names) == 26 and names == sorted(names) and "nbrdf:red-plastic" in names
    assert rig.Brdf.load(names[-1]).name == names[-1]


def test_files_are_read_as_the_program_reads_them(program, tmp_path):
    plastic = rig.Brdf.load("nbrdf:red-plastic")
    angles = np.array([[10, 20, 180], [30, 31, 170], [60, 5, 90]])
    program("brdf", "convert", "nbrdf:red-plastic", "--out", tmp_path / "program.binary")
    for name in ["plastic.binary", "plastic.bsdf"]:
        plastic.save(tmp_path / name)
        expected = evaluated_by(program, str(tmp_path / name), angles, tmp_path)
        assert np.array_equal(rig.Brdf.load(tmp_path / name).at(*angles.T), expected)
    written = [(tmp_path / f"{name}.binary").read_bytes() for name in ["plastic", "program"]]
    assert written[0] == written[1]


def test_shapes_are_broadcast():
    brdf = rig.Brdf.load("ggx:0.2,1.5")
    wi = directions(np.array([10.0, 40.0, 70.0]), 0.0)
    wo = directions(np.array([[0.0], [50.0]]), 180.0)
    f = brdf(wi, wo)
    assert (f.shape, f.dtype) == ((2, 3, 3), np.float32)
    for i in range(2):
        for j in range(3):
            assert np.array_equal(f[i, j], brdf(wi[j], wo[i, 0]))
    assert np.array_equal(brdf(wi.astype(np.float32), wo.tolist()), f)
    # Any strides; many enough to be shared among processors.
    many = np.repeat(wi, 2000, axis=0)
    assert np.array_equal(brdf(many[::-1], wo[0, 0])[::-2000][:, 0], f[0, ::-1][:, 0][::-1])
    assert brdf(np.empty((0, 3)), [0, 0, 1]).shape == (0, 3)


def test_mixtures_are_sums_of_their_atoms():
    atoms = [rig.Atom("ggx", alpha=0.2, eta=1.5), rig.Atom("lambertian", albedo=1.0), rig.Atom("black")]
    weights = np.array([[0.3, 0.5, 0.2], [0.3, 0.2, 0.5], [0.3, 0.1, 0.6]])
    mixture = rig.Brdf.mixture(atoms, weights)
    assert mixture.atoms == atoms and np.array_equal(mixture.weights, weights)
    wi, wo = directions(30.0, 0.0), directions(35.0, 170.0)
    lobe = rig.Brdf.load("ggx:0.2,1.5")(wi, wo)
    np.testing.assert_allclose(mixture(wi, wo), 0.3 * lobe + weights[:, 1] / np.pi, rtol=1e-6)
    grey = np.zeros(42)
    grey[40] = 1
    assert rig.Brdf.mixture("paper42", grey)(wi, wo)[0] == pytest.approx(1 / np.pi)
    assert rig.Brdf.load("nbrdf:red-plastic").atoms is None


def test_tables_are_at_half_and_difference_angles():
    brdf = rig.Brdf.load("nbrdf:red-plastic")
    table = brdf.table([0, 20], [10, 40, 70])
    assert table.shape == (2, 3, 3)
    # At θh = 0, light and viewer are at θd on either side of the normal.
    wi, wo = directions(40.0, 90.0), directions(40.0, 270.0)
    np.testing.assert_allclose(table[0, 1], brdf(wi, wo), rtol=1e-4)


def test_errors_and_spheres_are_those_of_the_program(program, tmp_path):
    estimate, truth = rig.Brdf.load("ggx:0.2,1.5"), rig.Brdf.load("ggx:0.3,1.5")
    expected = json.loads(
        program("brdf", "compare", "ggx:0.2,1.5", "ggx:0.3,1.5", "--size", 16, "--json")
    )
    errors = estimate.errors(truth, size=16)
    assert errors.environment.all == expected["environment"]["mean"]["all"]
    assert errors.maps == dict(expected["environment"]["maps"])
    assert errors.brdf.green == expected["brdf"]["relative"]["channels"][1]
    assert errors.cube_root.all == expected["brdf"]["cube_root"]["all"]
    picture = truth.spheres(16)
    assert (picture.shape, picture.dtype) == ((16, 64, 3), np.uint8)
    sphere = rig.Brdf.load("lambertian:1").environment_sphere("studio", 16)
    assert sphere[0, 0].tolist() == [0, 0, 0] and sphere[8, 8].min() > 0


def test_a_check_finds_what_is_not_physical():
    assert rig.Brdf.load("lambertian:0.5").check().largest_albedo == pytest.approx(0.5, abs=0.01)
    assert rig.Brdf.load("ggx:0.3,1.5").check().passes

"""Loads the exports of a fit in Mitsuba 3 and compares values. See README.md here.

Usage: mitsuba_export.py RIG_BINARY
"""

import csv
import io
import math
import struct
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import mitsuba as mi
import numpy as np

RIG = sys.argv[1]
failures = []

# Coloured; a narrow lobe, a broad one and a matte ground.
SCENE = """
[camera]
model = "orthographic"
resolution_px = [16, 16]
extent_mm = [2.2, 2.2]
position_mm = [0.0, 0.0, 5.0]
look_at_mm = [0.0, 0.0, 0.0]
up = [0.0, 1.0, 0.0]

[[light]]
kind = "directional"
to_light = [0.3, 0.2, 0.93]
irradiance = 1.0

[sample]
shape = { kind = "bowl", radius_mm = 1.0 }

[brdf]
mixture = [
  { weight = [0.30, 0.20, 0.10], ggx = { alpha = 0.05, eta = 1.5 } },
  { weight = [0.20, 0.30, 0.20], ggx = { alpha = 0.30, eta = 2.5 } },
  { weight = [0.40, 0.10, 0.05], lambertian = { albedo = 1.0 } },
  { weight = [0.10, 0.40, 0.65], black = {} },
]
"""


# The kinds of atoms that only rig26 has.
FACETS_AND_COAT = """mixture = [
  { weight = [0.50, 0.30, 0.20], coated = { eta = 1.5 } },
  { weight = [0.30, 0.20, 0.10], beckmann = { alpha = 0.27, eta = 20.0 } },
  { weight = [0.20, 0.50, 0.70], beckmann = { alpha = 0.075, eta = 1.5 } },
]
"""


def check(what, value, limit):
    verdict = "ok" if value <= limit else "FAILED"
    print(f"{verdict:6} {what}: {value:.3g} (allowed {limit:g})")
    if not value <= limit:
        failures.append(what)


def rig(*arguments):
    done = subprocess.run([RIG, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"rig {' '.join(map(str, arguments))} failed:\n{done.stderr}")
    return done.stdout


def rig_eval(spec, angles, folder):
    """f in 1/sr at rows of (theta_i, theta_o, phi) in degrees."""
    file = folder / "angles.csv"
    lines = ["theta_i_deg,theta_o_deg,phi_deg"]
    lines += [",".join(repr(float(x)) for x in row) for row in angles]
    file.write_text("\n".join(lines) + "\n")
    rows = csv.DictReader(io.StringIO(rig("brdf", "eval", "--brdf", spec, "--angles", file)))
    return np.array([[float(row[k]) for k in ("f_r", "f_g", "f_b")] for row in rows])


def direction(theta_deg, phi_deg):
    theta, phi = math.radians(theta_deg), math.radians(phi_deg)
    return [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]


def random_angles(count, seed):
    """Half anywhere up to 75 degrees, half within 15 degrees of the mirror direction."""
    numbers = np.random.default_rng(seed)
    rows = []
    while len(rows) < count:
        theta_i, theta_o = 75 * np.sqrt(numbers.random(2))
        phi = 360 * numbers.random()
        if len(rows) % 2:
            theta_o = np.clip(theta_i + 15 * numbers.normal() / 2, 0, 75)
            phi = 180 + 10 * numbers.normal()
        rows.append((theta_i, theta_o, phi % 360))
    return np.array(rows)


def interaction(theta_deg, wavelengths=None):
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*direction(theta_deg, 0))
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    if wavelengths is not None:
        si.wavelengths = wavelengths
    return si


def evaluate(bsdf, angles):
    """f cos theta_o by Mitsuba."""
    context = mi.BSDFContext()
    values = [
        np.array(bsdf.eval(context, interaction(i), mi.Vector3f(*direction(o, phi)))).ravel()
        for i, o, phi in angles
    ]
    return np.array(values)


def errors(name, got, want, all_limit, median_limit, worst_limit):
    relative = np.abs(got - want) / want
    check(f"{name}: sum of |errors| over sum of values", np.abs(got - want).sum() / want.sum(), all_limit)
    check(f"{name}: median relative error", np.median(relative), median_limit)
    check(f"{name}: largest relative error", relative.max(), worst_limit)


def check_sampling(name, bsdf, theta_i, albedo):
    """Samples follow pdf(), weigh f cos/pdf, vary little, and sum to the albedo."""
    context, si = mi.BSDFContext(), interaction(theta_i)
    numbers = np.random.default_rng(7)
    count, bins = 30000, (12, 24)
    histogram, weights, consistency = np.zeros(bins), [], 0.0
    for index in range(count):
        u = numbers.random(3)
        sampled, weight = bsdf.sample(context, si, float(u[0]), mi.Point2f(float(u[1]), float(u[2])))
        weight = np.array(weight).ravel()
        wo = np.array(sampled.wo).ravel()
        weights.append(weight @ [0.2126, 0.7152, 0.0722])
        if wo[2] <= 0:
            continue
        if index < 300 and sampled.pdf > 0:
            value = np.array(bsdf.eval(context, si, sampled.wo)).ravel() / sampled.pdf
            scale = max(np.abs(weight).max(), 1e-6)
            consistency = max(consistency, np.abs(value - weight).max() / scale)
        row = min(int(wo[2] ** 2 * bins[0]), bins[0] - 1)
        column = int((math.atan2(wo[1], wo[0]) / (2 * math.pi) % 1.0) * bins[1])
        histogram[row, min(column, bins[1] - 1)] += 1
    weights = np.array(weights)
    check(f"{name} at {theta_i} deg: weight against f cos/pdf, worst of 300", consistency, 0.02)
    check(f"{name} at {theta_i} deg: standard deviation of the weights over their mean", weights.std() / weights.mean(), 0.6)
    sigma = weights.std() / math.sqrt(count) / albedo
    check(f"{name} at {theta_i} deg: albedo by sampling, relative error", abs(weights.mean() / albedo - 1), 0.01 + 4 * sigma)
    # Expected counts: pdf() over cells of equal area in (cos^2 theta, phi).
    fine, expected = 10, np.zeros(bins)
    for row in range(bins[0]):
        for column in range(bins[1]):
            total = 0.0
            for a in range(fine):
                square = (row + (a + 0.5) / fine) / bins[0]
                cos = math.sqrt(square)
                sin = math.sqrt(1 - square)
                for b in range(fine):
                    phi = 2 * math.pi * (column + (b + 0.5) / fine) / bins[1]
                    wo = mi.Vector3f(sin * math.cos(phi), sin * math.sin(phi), cos)
                    # dw = d(cos^2) dphi / (2 cos)
                    total += float(bsdf.pdf(context, si, wo)) / (2 * cos)
            expected[row, column] = count * total / fine**2 / bins[0] * 2 * math.pi / bins[1]
    seen, wanted = histogram.ravel(), expected.ravel()
    order = np.argsort(wanted)
    chi2, cells, pool_seen, pool_wanted = 0.0, 0, 0.0, 0.0
    for cell in order:
        pool_seen, pool_wanted = pool_seen + seen[cell], pool_wanted + wanted[cell]
        if pool_wanted >= 20:
            chi2 += (pool_seen - pool_wanted) ** 2 / pool_wanted
            cells, pool_seen, pool_wanted = cells + 1, 0.0, 0.0
    # Normal approximation of the chi-square distribution (Wilson & Hilferty 1931).
    free = max(cells - 1, 1)
    z = ((chi2 / free) ** (1 / 3) - (1 - 2 / (9 * free))) / math.sqrt(2 / (9 * free))
    check(f"{name} at {theta_i} deg: chi-square of {cells} cells, standard deviations", z, 4.0)


def albedo_by_quadrature(spec, theta_i, folder):
    """Luminance of the directional albedo, from rig's own values."""
    n, m = 180, 180
    theta = (np.arange(n) + 0.5) / n * 90
    phi = (np.arange(m) + 0.5) / m * 180
    grid = np.array([(theta_i, t, p) for t in theta for p in phi])
    f = rig_eval(spec, grid, folder) @ [0.2126, 0.7152, 0.0722]
    rad = np.radians(grid[:, 1])
    solid = np.sin(rad) * np.cos(rad) * math.radians(90 / n) * 2 * math.radians(180 / m)
    return float((f * solid).sum())


def tensor_fields(path):
    data = Path(path).read_bytes()
    assert data[:12] == b"tensor_file\0" and data[12:14] == bytes([1, 0])
    (count,) = struct.unpack_from("<I", data, 14)
    at, fields = 18, {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, at)
        name = data[at + 2 : at + 2 + length].decode()
        at += 2 + length
        rank, kind, offset = struct.unpack_from("<HBQ", data, at)
        shape = struct.unpack_from(f"<{rank}Q", data, at + 11)
        at += 11 + 8 * rank
        fields[name] = (kind, shape, data[offset:])
    return fields


def check_pbrt_structure(path):
    """The conditions under which pbrt-v4's MeasuredBxDFData::Create accepts a file."""
    fields = tensor_fields(path)
    shape = {name: entry[1] for name, entry in fields.items()}
    kind = {name: entry[0] for name, entry in fields.items()}
    u8, f32 = 1, 10
    ranks = dict(theta_i=1, phi_i=1, wavelengths=1, ndf=2, sigma=2, vndf=4, luminance=4, spectra=5)
    good = kind["description"] == u8 and len(shape["description"]) == 1
    good &= kind["jacobian"] == u8 and shape["jacobian"] == (1,)
    good &= all(kind[k] == f32 and len(shape[k]) == rank for k, rank in ranks.items())
    first = (shape["phi_i"][0], shape["theta_i"][0])
    good &= all(shape[k][:2] == first for k in ("vndf", "luminance", "spectra"))
    good &= shape["luminance"][2] == shape["luminance"][3]
    good &= shape["spectra"][2] == shape["wavelengths"][0]
    good &= shape["luminance"][2:] == shape["spectra"][3:]
    check("pbrt: structure demanded of a file (0 is right)", 0 if good else 1, 0)


def check_spectral(path, angles, want):
    mi.set_variant("scalar_spectral")
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    context = mi.BSDFContext()
    wavelengths = np.arange(360.0, 831.0, 5.0)
    wavelengths = np.append(wavelengths, [830.0] * (-len(wavelengths) % 4))
    weight = np.array([float(mi.cie_d65(float(w))) for w in wavelengths])
    xyz = np.array([np.array(mi.cie1931_xyz(float(w))).ravel() for w in wavelengths])
    xyz = xyz * weight[:, None]
    xyz[95:] = 0
    srgb = np.array([[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]])
    matrix = srgb @ xyz.T
    matrix /= matrix.sum(axis=1, keepdims=True)  # D65 is white
    got = []
    for i, o, phi in angles:
        spectrum = []
        for k in range(0, len(wavelengths), 4):
            si = interaction(i, mi.Spectrum([float(w) for w in wavelengths[k : k + 4]]))
            spectrum += list(np.array(bsdf.eval(context, si, mi.Vector3f(*direction(o, phi)))).ravel())
        got.append(matrix @ np.array(spectrum))
    errors("rgl-spectral in scalar_spectral, colour under D65", np.array(got), want, 0.02, 0.01, 0.3)


def check_merl(path, spec, folder):
    data = Path(path).read_bytes()
    shape = struct.unpack_from("<3i", data)
    assert shape == (90, 90, 180)
    table = np.frombuffer(data, "<f8", offset=12).reshape(3, *shape)
    numbers = np.random.default_rng(3)
    rows, values = [], []
    for _ in range(400):
        h, d, p = numbers.integers(0, [70, 80, 180])
        theta_h, theta_d, phi_d = np.radians([h * h / 90.0, d, p])
        half = np.array([math.sin(theta_d) * math.cos(phi_d), math.sin(theta_d) * math.sin(phi_d), math.cos(theta_d)])
        turn = np.array([[math.cos(theta_h), 0, math.sin(theta_h)], [0, 1, 0], [-math.sin(theta_h), 0, math.cos(theta_h)]])
        i, o = turn @ half, turn @ (half * [-1, -1, 1])
        if min(i[2], o[2]) < 0.05:
            continue
        phi = math.degrees(math.atan2(o[1], o[0]) - math.atan2(i[1], i[0])) % 360
        rows.append([math.degrees(math.acos(min(i[2], 1))), math.degrees(math.acos(min(o[2], 1))), phi])
        values.append(table[:, h, d, p] * np.array([1, 1.15, 1.66]) / 1500)
    want = rig_eval(spec, rows, folder)
    errors("merl: values at nodes", np.array(values), want, 1e-3, 1e-4, 0.02)


def load_blend(path):
    text = path.read_text()
    # A BSDF alone: the scene's only child.
    inner = text[text.index("<bsdf") : text.rindex("</bsdf>") + 7]
    return mi.load_string(inner.replace("<bsdf", '<bsdf version="3.0.0"', 1))


def check_other_atoms(folder, angles):
    """Beckmann lobes and coated white. Mitsuba's mean transmittance of the coat is a fit."""
    scene, image, fit, xml = (folder / name for name in ("b.toml", "b.exr", "b", "b.xml"))
    scene.write_text(SCENE[: SCENE.index("mixture")] + FACETS_AND_COAT)
    rig("render", "--scene", scene, "--out", image, "--spp", 64, "--seed", 3)
    rig("fit", "--scene", scene, "--image", image, "--out", fit, "--dictionary", "rig26", "--spp", 64)
    rig("export", fit, "--format", "mitsuba", "--out", xml)
    text = xml.read_text()
    check("mitsuba: no coat or no Beckmann lobe", 0 if '"plastic"' in text and '"beckmann"' in text else 1, 0)
    want = rig_eval(f"rig26:{fit / 'weights.csv'}", angles, folder)
    want *= np.cos(np.radians(angles[:, 1]))[:, None]
    errors("mitsuba: coat and Beckmann lobes", evaluate(load_blend(xml), angles), want, 2e-3, 2e-3, 1e-2)


def main():
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        scene = folder / "scene.toml"
        scene.write_text(SCENE)
        image = folder / "image.exr"
        rig("render", "--scene", scene, "--out", image, "--spp", 64, "--seed", 3)
        fit = folder / "fit"
        rig("fit", "--scene", scene, "--image", image, "--out", fit, "--dictionary", "paper42", "--spp", 64)
        # Every format is compared with the weights' mixture, from which this fit must not depart.
        discrepancy = tomllib.loads((fit / "fit.toml").read_text())["discrepancy"]
        check("discrepancy from the mixture", discrepancy, 0.0)
        spec = f"paper42:{fit / 'weights.csv'}"
        for format, name in [
            ("mitsuba", "a.xml"),
            ("rgl", "a.bsdf"),
            ("rgl-spectral", "s.bsdf"),
            ("pbrt", "a.pbrt"),
            ("merl", "a.binary"),
            ("json", "a.json"),
        ]:
            rig("export", fit, "--format", format, "--out", folder / name)
        angles = random_angles(800, 1)
        cos_o = np.cos(np.radians(angles[:, 1]))[:, None]
        want = rig_eval(spec, angles, folder) * cos_o

        mi.set_variant("scalar_rgb")
        errors("mitsuba: blends in scalar_rgb", evaluate(load_blend(folder / "a.xml"), angles), want, 1e-5, 1e-5, 2e-3)
        check_other_atoms(folder, angles)

        measured = mi.load_dict({"type": "measured", "filename": str(folder / "a.bsdf")})
        errors("rgl: measured in scalar_rgb", evaluate(measured, angles), want, 0.01, 0.005, 0.3)
        for theta_i in (10, 60):
            check_sampling("rgl", measured, theta_i, albedo_by_quadrature(spec, theta_i, folder))
        # A lobe narrower than any table of directions, alone and on a matte ground.
        for lobe in ("ggx:0.02,1.5", "nbrdf:red-plastic"):
            file = folder / "lobe.bsdf"
            rig("brdf", "convert", lobe, "--out", file)
            narrow = mi.load_dict({"type": "measured", "filename": str(file)})
            values = rig_eval(lobe, angles, folder) * cos_o
            check(f"{lobe}: sum of |errors| over sum of values", np.abs(evaluate(narrow, angles) - values).sum() / values.sum(), 0.03)

        check_pbrt_structure(folder / "a.spectral.bsdf")
        check_spectral(folder / "s.bsdf", angles[:60], want[:60])
        check_merl(folder / "a.binary", spec, folder)
    if failures:
        sys.exit(f"{len(failures)} checks failed: {', '.join(failures)}")


main()

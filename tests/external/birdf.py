"""Validates `rig export --format birdf` by the format's schema, and reads it with a second reader.

Usage: birdf.py RIG_BINARY
"""

import csv
import json
import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import jsonschema
import numpy as np
from referencing import Registry, Resource

RIG = str(Path(sys.argv[1]).resolve())
HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
LAB = """
organisation = "Institute of Optics"
operator = "A. Miller"
contact = "B. Jones"
email = "reflectometry@example.org"
website = "https://example.org"
street = "Long Street"
building = "8"
postal_code = "02150"
city = "Espoo"
country = "Finland"
band_r_nm = [605, 640]
band_g_nm = [510, 550]
band_b_nm = [450, 480]
camera_band_nm = [400, 1000]
lamp_power_w = 9.0
"""


def rig(folder, *arguments):
    done = subprocess.run([RIG, *arguments], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"rig {' '.join(arguments)} failed:\n{done.stderr}")
    return done.stdout.strip().splitlines()[-1]


def captured(folder, lab):
    """A session of the small simulated bench, with a fit."""
    text = (ROOT / "rig-configs/simulated.toml").read_text()
    for old, new in [
        ("\nresolution_px = [640, 480]", "\nresolution_px = [64, 64]"),
        ("\nextent_mm = [29.3, 22.0]", "\nextent_mm = [22.0, 22.0]"),
        ("\npoint_spread_px = 0.5", "\npoint_spread_px = 0.0"),
        ("\n[lab]\n", f"\n[lab]\n{lab}"),
    ]:
        assert old in text, old
        text = text.replace(old, new, 1)
    (folder / "rig.toml").write_text(text)
    shutil.copytree(ROOT / "tests/support/small_bench/calibration", folder / "calibration/simulated")
    rig(folder, "capture", "--lights", "2", "--sample", "red-plastic")
    return next((folder / "sessions").iterdir())


def validator():
    files = [json.loads(file.read_text()) for file in sorted((HERE / "birdf_schema").glob("*.json"))]
    registry = Registry().with_resources((file["$id"], Resource.from_contents(file)) for file in files)
    whole = next(file for file in files if file["$id"].endswith("/brdf_json_schema_v1.0.json"))
    return jsonschema.Draft202012Validator(
        whole, registry=registry, format_checker=jsonschema.Draft202012Validator.FORMAT_CHECKER
    )


def half_and_difference_deg(theta_i, phi_i, theta_r, phi_r):
    """Rusinkiewicz angles by their definition, from angles in degrees."""

    def direction(theta, phi):
        theta, phi = math.radians(theta), math.radians(phi)
        return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])

    light, viewer = direction(theta_i, phi_i), direction(theta_r, phi_r)
    half = (light + viewer) / np.linalg.norm(light + viewer)
    theta_h = math.degrees(math.atan2(math.hypot(half[0], half[1]), half[2]))
    theta_d = math.degrees(math.atan2(np.linalg.norm(np.cross(light, half)), light @ half))
    return theta_h, theta_d


def compare_with_table(document, fit):
    """Every row by its directions alone against the fit's table.csv."""
    with open(fit / "table.csv", newline="") as file:
        table = list(csv.DictReader(file))
    nodes = np.array([[float(row["theta_h_deg"]), float(row["theta_d_deg"])] for row in table])
    data = document["data"]
    names = ["theta_i", "phi_i", "theta_r", "phi_r", "BRDF", "uBRDF"]
    columns = [data[name]["values"] for name in names] + [data["adhoc_variables"]["channel"]["values"]]
    rows = list(zip(*columns, strict=True))
    for *angles, f, u, channel in rows:
        theta_h, theta_d = half_and_difference_deg(*angles)
        distance = np.abs(nodes - [theta_h, theta_d]).max(axis=1)
        row = table[int(distance.argmin())]
        assert distance.min() < 1e-4, (theta_h, theta_d)
        assert row["constrained"] == "true"
        c = channel.lower()
        assert f == float(row[f"f_{c}"])
        assert math.isclose(u, (float(row[f"upper_{c}"]) - float(row[f"lower_{c}"])) / 2, rel_tol=1e-12)
    above = [row for row in table if max(float(row["theta_h_deg"]), float(row["theta_d_deg"])) < 90]
    constrained = sum(row["constrained"] == "true" for row in above)
    assert len(rows) == 3 * constrained, (len(rows), constrained)
    return len(rows)


def main():
    valid = validator()
    for name, lab in [("stated", LAB), ("not stated", "")]:
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            session = captured(folder, lab)
            rig(folder, "export", str(session), "--format", "birdf", "--out", "x.json")
            document = json.loads((folder / "x.json").read_text())
            valid.validate(document)
            rows = compare_with_table(document, max((session / "fits").iterdir()))
            assert document["metadata"]["method"] == "simulation"
            # Where bands and power are stated, the instrument is described.
            assert (document["metadata"]["instrumentation"] != "NA") == (name == "stated")
            print(f"ok     birdf, lab {name}: valid by the schema, {rows} rows are those of table.csv")
    # What the schema forbids is refused, so that it can fail.
    document["data"]["BRDF"]["values"][0] = -1
    assert not valid.is_valid(document)


main()

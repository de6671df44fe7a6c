"""Sessions of the small simulated bench of tests/support/small_bench, captured in a moment."""

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

CHANGES = [
    ("\nresolution_px = [640, 480]", "\nresolution_px = [64, 64]"),
    ("\nextent_mm = [29.3, 22.0]", "\nextent_mm = [22.0, 22.0]"),
    ("\npoint_spread_px = 0.5", "\npoint_spread_px = 0.0"),
]
QUICK = {
    "samples_per_pixel": "2",
    "max_reflections": "2",
    "segments": "32",
    "timing": '"instant"',
}
# Options of quick fits, the same numbers everywhere; `capture` writes the dictionary.
FIT = "--spp 16 --dictionary few.toml --kernel portable"
DICTIONARY = """atoms = [
  { type = "lambertian", albedo = 1.0 },
  { type = "ggx", alpha = 0.3, eta = 1.5 },
  { type = "black" },
]
"""
ALBEDOS = [0.8, 0.5, 0.3]


def capture(rig, folder, count, lights=1):
    """Makes `count` sessions below `folder`, of a few materials; their paths."""
    text = (ROOT / "rig-configs/simulated.toml").read_text()
    for old, new in CHANGES:
        assert old in text, old
        text = text.replace(old, new, 1)
    before, simulation = text.split("[simulation]", 1)
    originals = []
    for albedo in ALBEDOS[:count]:
        place = folder / f"bench-{albedo}"
        shutil.copytree(ROOT / "tests/support/small_bench/calibration", place / "calibration/simulated")
        lines = []
        for line in simulation.splitlines():
            key = line.split(" = ")[0]
            if key == "material":
                line = f"brdf = {{ mixture = [ {{ weight = 1.0, lambertian = {{ albedo = {albedo} }} }} ] }}"
            elif key in QUICK:
                line = f"{key} = {QUICK[key]}"
            lines.append(line)
        (place / "rig.toml").write_text(before + "[simulation]" + "\n".join(lines))
        command = [rig, "--quiet", "capture", "--lights", str(lights), "--no-fit"]
        command += ["--sample", f"grey-{albedo}"]
        done = subprocess.run(command, cwd=place, check=True, stdout=subprocess.PIPE, text=True)
        originals.append(place / done.stdout.splitlines()[-1])
    (folder / "few.toml").write_text(DICTIONARY)
    sessions = folder / "sessions"
    sessions.mkdir()
    paths = []
    for number in range(count):
        path = sessions / f"s{number:03}"
        shutil.copytree(originals[number % len(originals)], path)
        paths.append(path)
    return paths

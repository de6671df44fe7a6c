#!/usr/bin/env python3
"""Makes the pictures of the documentation: make.py RIG [FOLDER FOR INTERMEDIATE FILES]

RIG is the built program. Needs headless Chromium, and from PyPI pillow, numpy and OpenEXR.
Takes about three minutes. growth.png is made by `rig bench --growth DIR`.
"""
import glob
import pathlib
import shutil
import subprocess
import sys

import numpy
import OpenEXR
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
SCENE = """
[camera]
model = "orthographic"
resolution_px = [240, 240]
extent_mm = [22.0, 22.0]
position_mm = [0.0, 0.0, 200.0]
[[light]]
kind = "directional"
to_light = [0.7071, 0.0, 0.7071]
irradiance = 3.14
[sample]
shape = { kind = "bowl", radius_mm = 10.0, segments = 192 }
shading = "smooth"
[brdf]
mixture = [
  { weight = [0.75, 0.35, 0.2], lambertian = { albedo = 1.0 } },
  { weight = 0.15, ggx = { alpha = 0.1, eta = 1.5 } },
  { weight = [0.1, 0.5, 0.65], black = {} },
]
"""


def save(image, name, colours=128):
    """Few colours keep the repository small; the pictures have few anyway."""
    image = image.convert("RGB").quantize(colours, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    image.save(HERE / name, optimize=True)


def side_by_side(images, gap=10, background="white"):
    width = sum(i.width for i in images) + gap * (len(images) - 1)
    row = Image.new("RGB", (width, max(i.height for i in images)), background)
    x = 0
    for image in images:
        row.paste(image, (x, 0))
        x += image.width + gap
    return row


def raw_frame(path):
    """12-bit counts in a 16-bit file, shown linearly: full scale is white."""
    counts = numpy.asarray(Image.open(path)).astype(float)
    return Image.fromarray(numpy.uint8(numpy.clip(counts / 4095 * 255, 0, 255))).resize((320, 240))


def exr(path):
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        if "RGB" in channels:
            return channels["RGB"].pixels[:, :, :3].astype(float)
        return numpy.stack([channels[c].pixels for c in "RGB"], -1).astype(float)


def tone(radiance, white):
    return Image.fromarray(numpy.uint8(255 * numpy.clip(radiance / white, 0, 1) ** (1 / 2.2)))


def main():
    rig = str(pathlib.Path(sys.argv[1]).resolve())
    work = pathlib.Path(sys.argv[2] if len(sys.argv) > 2 else "target/pictures").resolve()
    work.mkdir(parents=True, exist_ok=True)
    run = lambda *arguments: subprocess.run([rig, *arguments], cwd=work, check=True)

    # A session of the simulated bench, and its report as a browser shows it.
    if not glob.glob(f"{work}/sessions/*"):
        run("capture", "--lights", "4", "--sample", "red-paint")
    session = pathlib.Path(sorted(glob.glob(f"{work}/sessions/*_red-paint_*"))[-1])
    run("report", str(session), "--fit", "0", "--out", f"{work}/report.html")
    subprocess.run(["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                    "--window-size=900,9000", f"--screenshot={work}/report.png",
                    f"file://{work}/report.html"], check=True, stderr=subprocess.DEVNULL)
    report = Image.open(work / "report.png").convert("RGB")
    # Where the parts stand is read from the page by eye: look at them when the report changes.
    save(report.crop((0, 20, 900, 540)), "report.png")
    save(report.crop((0, 670, 900, 1125)), "spheres.png", 256)
    save(report.crop((0, 2225, 900, 2655)), "residuals.png", 256)
    save(report.crop((0, 4550, 900, 4795)), "slices.png", 256)

    # Its fit over the truth.
    run("brdf", "plot", str(session), "nbrdf:dark-red-paint", "--kind", "lobes", "--out", "lobes.png")
    lobes = Image.open(work / "lobes.png")
    save(lobes.resize((1300, lobes.height * 1300 // lobes.width), Image.Resampling.LANCZOS), "lobes.png", 64)

    # Three exposures of one bracket under the first lamp channel: 1.2, 13 and 134 ms.
    bracket = [f"{session}/raw/L000_E{e}_R00_light.png" for e in ("08", "16", "24")]
    save(side_by_side([raw_frame(p) for p in bracket], background="#888"), "bracket.png", 64)

    # The same bowl by direct light alone, by interreflected light alone, and by both.
    (work / "scene.toml").write_text(SCENE)
    for name, reflections in (("all", "16"), ("direct", "1")):
        run("render", "--scene", "scene.toml", "--out", f"{name}.exr", "--spp", "256", "--max-reflections", reflections)
    both, direct = exr(work / "all.exr"), exr(work / "direct.exr")
    white = numpy.quantile(both, 0.995)
    save(side_by_side([tone(i, white) for i in (direct, numpy.maximum(both - direct, 0), both)]), "direct-indirect.png", 256)

    # The material of the tutorial's second page.
    tutorial = (HERE.parent / "tutorial-images.md").read_text()
    (work / "tutorial.toml").write_text(tutorial.split("```toml\n")[1].split("```")[0])
    run("render", "--scene", "tutorial.toml", "--out", "img.exr")
    shutil.rmtree(work / "fit", ignore_errors=True)
    run("fit", "--scene", "tutorial.toml", "--image", "img_L000.exr", "img_L001.exr", "--out", "fit")
    run("brdf", "plot", "fit", "--out", "tutorial-spheres.png")
    save(Image.open(work / "tutorial-spheres.png").resize((800, 200), Image.Resampling.LANCZOS), "tutorial-spheres.png", 200)

    # A measured material as OpenPBR holds it.
    run("brdf", "convert", "nbrdf:red-plastic", "--out", "red.mtlx")
    as_openpbr = Image.open(work / "red.mtlx.png")
    save(as_openpbr.resize((736, as_openpbr.height * 736 // as_openpbr.width), Image.Resampling.LANCZOS), "as-openpbr.png", 200)

    # Figures of experiments.
    for experiment in ("atoms", "table-visits", "shape-construction"):
        run("evaluate", experiment, "--out", f"evaluate/{experiment}")
        shutil.copy(work / f"evaluate/{experiment}/{experiment}.png", work)
    figure = Image.open(work / "table-visits.png")
    save(figure.resize((1100, figure.height * 1100 // figure.width), Image.Resampling.LANCZOS), "table-visits.png", 64)
    atoms = Image.open(work / "atoms.png")
    save(atoms.resize((760, atoms.height * 760 // atoms.width), Image.Resampling.LANCZOS), "atoms.png", 24)
    shutil.copy(work / "evaluate/shape-construction/shape-construction.svg", HERE)


if __name__ == "__main__":
    main()

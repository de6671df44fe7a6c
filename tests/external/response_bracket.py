"""Response curves and merged radiance of a published bracket, `rig` beside OpenCV.

    pip install opencv-python-headless==5.0.0.93 OpenEXR==3.5.3 numpy
    python tests/external/response_bracket.py target/release/rig FOLDER

FOLDER holds the frames (PNG, by name from the longest exposure to the shortest) and
`exposures.csv` (`file,exposure_s`). For Debevec and Malik's memorial church (SIGGRAPH
1997): memorial0061.png to memorial0076.png, 32 s and each next one half of that; a region
of 4,31,503,716 leaves out the coloured margins of its registration, see --region.
"""

import argparse
import csv
import fractions
import pathlib
import subprocess
import tempfile
import tomllib

import cv2
import numpy as np
import OpenEXR

COUNTS = np.arange(30, 236)
CHANNELS = ["red", "green", "blue"]


def rig(binary, *arguments):
    done = subprocess.run([binary, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    return done.stdout


def curves(record):
    """ln exposure by count (256 x 3), 0 at count 128, and its standard uncertainty."""
    channels = tomllib.loads(pathlib.Path(record).read_text())["values"]["channels"]
    return [np.array([c[key] for c in channels]).T for key in ("ln_exposure", "ln_std")]


def radiance(path):
    with OpenEXR.File(str(path), separate_channels=True) as image:
        channels = image.channels()
        planes = [channels[name].pixels for name in "RGB"]
        valid = channels["mask"].pixels if "mask" in channels else None
    return np.stack(planes, axis=-1).astype(np.float64), valid


def opencv(frames, times, samples):
    """Curves of both estimators, red, green, blue, and the merge of each."""
    bgr = [np.ascontiguousarray(frame[..., ::-1]) for frame in frames]
    times = np.array(times, np.float32)
    found = {}
    for name, estimator in [
        ("debevec", cv2.createCalibrateDebevec(samples, 10.0, False)),
        ("robertson", cv2.createCalibrateRobertson(300, 1e-5)),
    ]:
        response = estimator.process(bgr, times)
        merger = cv2.createMergeDebevec() if name == "debevec" else cv2.createMergeRobertson()
        with np.errstate(divide="ignore"):
            curve = np.log(response[:, 0, ::-1].astype(np.float64))
        merged = merger.process(bgr, times, response)[..., ::-1].astype(np.float64)
        curve -= curve[128]
        found[name] = (curve, {f"OpenCV {name}": merged})
        if name == "debevec":
            found[name][1]["equation 6 over counts 30 to 240"] = well_exposed(frames, times, curve)
    return found


def well_exposed(frames, times, curve):
    """The merge of Debevec and Malik's equation 6 without counts that may be the film's or
    scanner's black or white, to which OpenCV gives some weight in every frame."""
    total, weights = 0.0, 0.0
    for frame, t in zip(frames, times):
        z = frame.astype(int)
        w = np.where((z >= 30) & (z <= 240), np.minimum(z + 1, 256 - z), 0).astype(float)
        g = np.stack([curve[z[..., c], c] for c in range(3)], axis=-1)
        total += np.where(w > 0, w * (g - np.log(t)), 0)
        weights += w
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weights > 0, np.exp(total / weights), 0)


def describe(ratio):
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    return f"{100 * np.median(np.abs(ratio - middle)):.2f}% (5 to 95%: {100 * (low - middle):+.1f} to {100 * (high - middle):+.1f}%)"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("rig")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--region", default=None, help="X,Y,W,H without margins")
    parser.add_argument("--samples", type=int, default=400, help="OpenCV's samples")
    args = parser.parse_args()
    table = args.folder / "exposures.csv"
    with open(table) as lines:
        rows = [row for row in csv.reader(lines) if row[1] != "exposure_s"]
    times = [float(fractions.Fraction(t)) for _, t in rows]
    frames = [cv2.imread(str(args.folder / name))[..., ::-1] for name, _ in rows]
    region = [int(n) for n in args.region.split(",")] if args.region else [0, 0, *frames[0].shape[1::-1]]
    x, y, w, h = region
    inside = np.s_[y : y + h, x : x + w]
    reference = opencv([frame[inside] for frame in frames], times, args.samples)
    paths = [args.folder / name for name, _ in rows]
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        for method, (curve, merged) in reference.items():
            options = ["--region", args.region] if args.region else []
            record = rig(
                args.rig, "calibrate", "response", *paths, "--exposures", table, "--method", method,
                "--out", scratch, "--id", method, "--rig", "simulated", *options,
            ).strip()
            own, std = curves(record)
            out = scratch / f"{method}.exr"
            rig(args.rig, "merge", *paths, "--exposures", table, "--response", record, "--out", out)
            image, valid = radiance(out)
            image = image[inside]
            print(f"\n{method}")
            for c, name in enumerate(CHANNELS):
                seen = COUNTS[np.isfinite(curve[COUNTS, c])]
                off = own[seen, c] - curve[seen, c]
                off -= off.mean()
                worst = np.abs(off).argmax()
                print(
                    f"  {name:5} ln exposure over counts {COUNTS[0]} to {COUNTS[-1]}: rms "
                    f"{off.std():.4f}, at most {off[worst]:+.3f} at {seen[worst]}, "
                    f"stated {std[seen, c].mean():.4f}"
                )
            for merge, reference_image in merged.items():
                good = (image > 0).all(-1) & (reference_image > 0).all(-1)
                if valid is not None:
                    good &= valid[inside] > 0
                print(f"  rig over {merge}: {100 * good.mean():.2f}% of the pixels")
                for c, name in enumerate(CHANNELS):
                    a, b = image[..., c][good], reference_image[..., c][good]
                    ratio = np.log(a / b)
                    ratio -= np.median(ratio)
                    print(f"    {name:5} {describe(ratio)}")
                    decades = np.floor(np.log10(b / np.median(b))).astype(int)
                    for d in np.unique(decades):
                        here = ratio[decades == d]
                        if len(here) > 200:
                            print(f"      10^{d:+d} of the median: {100 * np.median(here):+.2f}%, {describe(here)}, {len(here)} pixels")


if __name__ == "__main__":
    main()

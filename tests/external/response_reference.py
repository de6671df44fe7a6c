"""Makes tests/data/response: a bracket of a known camera, and the response
curves that OpenCV finds in it.

    pip install opencv-python-headless==5.0.0.93 numpy
    python tests/external/response_reference.py tests/data/response

The camera: three curves, a display gamma, an S-shaped film and nearly linear;
noise of 0.6 counts and rounding. Exposures a factor of 2 apart, and radiances
that never clip: a clipped count says nothing of the curve, but OpenCV counts it.
"""

import pathlib
import sys

import cv2
import numpy as np

WIDTH, HEIGHT = 48, 32
EXPOSURES_S = [2.0**-k for k in range(4, -1, -1)]


def film(x):
    """A sigmoid in the logarithm of the exposure, 0.5 at 0.1."""
    return 1.0 / (1.0 + (0.1 / np.maximum(x, 1e-9)) ** 1.1)


CURVES = [
    lambda x: np.clip(x, 0, 1) ** (1 / 2.2),
    film,
    lambda x: np.clip(1.02 * x - 0.04 * x * x, 0, 1),
]


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(20261122)
    # Blue, green, red in OpenCV's order; 0.2 to 0.88 of what clips in 1 s.
    radiance = np.exp(rng.uniform(np.log(0.2), np.log(0.88), (HEIGHT, WIDTH)))
    images = []
    for t in EXPOSURES_S:
        planes = [
            np.clip(np.rint(255 * curve(radiance * t) + rng.normal(0, 0.6, radiance.shape)), 0, 255)
            for curve in CURVES
        ]
        image = np.stack(planes[::-1], axis=-1).astype(np.uint8)
        images.append(image)
        cv2.imwrite(str(folder / f"bracket_{round(1 / t):03d}.png"), image)
    times = np.array(EXPOSURES_S, np.float32)
    # 384 samples: every second pixel of every second row, from (1, 1) on.
    debevec = cv2.createCalibrateDebevec(384, 10.0, False).process(images, times)
    robertson = cv2.createCalibrateRobertson(300, 1e-5).process(images, times)
    for name, curve in [("debevec", debevec), ("robertson", robertson)]:
        with open(folder / f"opencv_{name}.csv", "w") as out:
            out.write("count,red,green,blue\n")
            for count in range(256):
                b, g, r = curve[count, 0]
                out.write(f"{count},{r:.7g},{g:.7g},{b:.7g}\n")
    with open(folder / "truth.csv", "w") as out:
        # Exposure at which each curve gives the middle count, and the others by it.
        out.write("count,red,green,blue\n")
        x = np.geomspace(1e-7, 50, 2_000_000)
        columns = []
        for curve in CURVES:
            y = 255 * curve(x)
            rises = np.concatenate([[True], np.diff(np.maximum.accumulate(y)) > 0])
            columns.append(np.interp(np.arange(256), np.maximum.accumulate(y)[rises], x[rises]))
        for count in range(256):
            out.write(",".join([str(count)] + [f"{c[count] / c[128]:.7g}" for c in columns]) + "\n")


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))

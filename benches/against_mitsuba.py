#!/usr/bin/env python3
"""One pass of rig beside Mitsuba 3 in one run: image and gradient at 64 x 64, 256
samples per pixel, 8 reflections, on the bowl and the corner of `rig bench`.

    python3 -m venv v && v/bin/pip install mitsuba==3.9.1
    export DRJIT_LIBLLVM_PATH=…      # libLLVM 19; 14 to 16 cannot compile its AVX-512 code
    v/bin/python benches/against_mitsuba.py [--rig target/release/rig] [--atoms 2] [--json]

Mitsuba renders with `prb` and propagates the gradient of a squared loss back to the
weights of nested `blendbsdf`s, after one pass that is not measured (it compiles the
kernels). rig's pass gives image, gradient and the Jacobian of every pixel for all
26 atoms of rig26, from cached paths; tracing them is listed apart.
CPU seconds are those of the whole process, all threads.
"""

import argparse
import json
import math
import os
import subprocess
import tempfile
import time

import drjit as dr
import mitsuba as mi

PIXELS = 64
SAMPLES = 256
REFLECTIONS = 8
SHAPES = {
    "bowl": (["bowl", "--radius", "1", "--segments", "200"], 0.0),
    "corner": (["tetrahedron", "--radius", "1", "--depth", str(math.sqrt(0.5))], 25.0),
}
ALPHAS = [0.01, 0.018, 0.032, 0.058, 0.104, 0.186, 0.334, 0.6]
ETAS = [1.3, 1.6, 2.4, 5.0, 20.0]
# A grid of lobes, spread so that the first few differ much.
LOBES = [(alpha, eta) for eta in ETAS[::-1] for alpha in ALPHAS[::-1]]


def material(atoms):
    """`atoms` atoms of equal weight, the last one diffuse: blends within blends."""
    blend = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    for count in range(1, atoms):
        alpha, eta = LOBES[(count - 1) * 7 % len(LOBES)]
        lobe = {"type": "roughconductor", "distribution": "ggx", "alpha": alpha}
        lobe.update(eta=eta, k=0.0)
        # `weight` is the share of the second BSDF.
        blend = {"type": "blendbsdf", "weight": count / (count + 1), "a": lobe, "b": blend}
    return blend


def scene(mesh, light_deg, atoms):
    sin, cos = math.sin(math.radians(light_deg)), math.cos(math.radians(light_deg))
    to_world = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {
                "type": "prb",
                "max_depth": REFLECTIONS + 1,
                "rr_depth": 1000,
            },
            "sensor": {
                "type": "orthographic",
                "to_world": to_world @ mi.ScalarTransform4f().scale([1.1, 1.1, 1.0]),
                "film": {
                    "type": "hdrfilm",
                    "width": PIXELS,
                    "height": PIXELS,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent", "sample_count": SAMPLES},
            },
            "lamp": {
                "type": "directional",
                "direction": [-sin, 0.0, -cos],
                "irradiance": {"type": "rgb", "value": 1.0},
            },
            "sample": {
                "type": "ply",
                "filename": mesh,
                "face_normals": True,
                "bsdf": material(atoms),
            },
        }
    )


def mitsuba(mesh, light_deg, atoms, repeats):
    """Median (CPU s, wall s) of forward and gradient, and the image's mean."""
    loaded = scene(mesh, light_deg, atoms)
    params = mi.traverse(loaded)
    weights = [key for key in params.keys() if key.endswith("weight.value")]
    assert len(weights) == atoms - 1, params
    target = mi.render(loaded, spp=SAMPLES, seed=1000)
    dr.eval(target)
    times = []
    for seed in range(repeats + 1):
        cpu, wall = time.process_time(), time.perf_counter()
        for key in weights:
            params[key] = mi.Float(dr.detach(params[key]))
            dr.enable_grad(params[key])
        params.update()
        image = mi.render(loaded, params, spp=SAMPLES, seed=2 * seed, seed_grad=2 * seed + 1)
        loss = dr.mean(dr.square(image - target))
        dr.backward(loss)
        gradient = [dr.grad(params[key]) for key in weights]
        dr.eval(loss, image, *gradient)
        dr.sync_thread()
        assert all(g[0] != 0.0 for g in gradient), "a weight without a derivative"
        times.append((time.process_time() - cpu, time.perf_counter() - wall))
    # The first one compiles.
    middle = [sorted(t[k] for t in times[1:])[repeats // 2] for k in range(2)]
    return middle[0], middle[1], float(dr.mean(target, axis=None).array[0])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rig", default="target/release/rig")
    parser.add_argument("--atoms", type=int, default=2, help="2 to 41")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)

    rig = {}
    for cases in ("evaluate", "trace"):
        command = [arguments.rig, "-q", "bench", "--json", "--threads", "1", "--only", cases]
        bench = subprocess.run(command, check=True, capture_output=True)
        rig.update({case["name"]: case for case in json.loads(bench.stdout)["cases"]})
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (shape, light_deg) in SHAPES.items():
            mesh = os.path.join(folder, name + ".ply")
            subprocess.run(
                [arguments.rig, "shape", *shape, "--out", mesh], check=True, capture_output=True
            )
            cpu_s, wall_s, mean = mitsuba(mesh, light_deg, arguments.atoms, arguments.repeat)
            one_pass, trace = rig["evaluate/" + name], rig["trace/" + name]
            rows.append(
                {
                    "scene": name,
                    "mitsuba_cpu_s": cpu_s,
                    "mitsuba_wall_s": wall_s,
                    "mitsuba_mean_radiance": mean,
                    "rig_pass_cpu_s": 1e-3 * one_pass["cpu_ms_median"],
                    "rig_trace_cpu_s": 1e-3 * trace["cpu_ms_median"],
                    "cpu_ratio_pass": 1e3 * cpu_s / one_pass["cpu_ms_median"],
                    "cpu_ratio_trace_and_pass": 1e3
                    * cpu_s
                    / (one_pass["cpu_ms_median"] + trace["cpu_ms_median"]),
                }
            )
    about = {
        "variant": arguments.variant,
        "mitsuba": mi.__version__,
        "mitsuba_atoms": arguments.atoms,
        "rig_atoms": 26,
        "load_1min": os.getloadavg()[0],
    }
    if arguments.json:
        print(json.dumps({**about, "scenes": rows}, indent=2))
        return
    print(", ".join(f"{key} {value}" for key, value in about.items()))
    print("| scene | Mitsuba forward + gradient, CPU s (wall s) | rig's pass, CPU s | ratio | rig's tracing, CPU s | ratio with tracing |")
    print("|---|---:|---:|---:|---:|---:|")
    for row in rows:
        print(
            f"| {row['scene']} | {row['mitsuba_cpu_s']:.2f} ({row['mitsuba_wall_s']:.2f}) "
            f"| {row['rig_pass_cpu_s']:.4f} | {row['cpu_ratio_pass']:.0f} "
            f"| {row['rig_trace_cpu_s']:.2f} | {row['cpu_ratio_trace_and_pass']:.1f} |"
        )


if __name__ == "__main__":
    main()

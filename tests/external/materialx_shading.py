"""Exported OpenPBR materials as MaterialX itself shades them: materialx_shading.py RIG_BINARY

MaterialX turns the material into GLSL with one directional light, and OpenGL, in software
where there is no GPU, evaluates it for every direction of light that a map has. Spheres under
the maps must have the error against the measured material that the file states.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import moderngl
import numpy as np
import OpenEXR
from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenShader

import openpbr
from spheres import mean_error, read_merl

RIG = sys.argv[1]
ROOT = Path(__file__).resolve().parents[2]
MAPS = [ROOT / "core/data/envmaps" / f"{name}.exr" for name in ("city", "forest", "studio", "sunset")]
MATERIALS = ["white-diffuse-bball", "red-plastic", "alum-bronze", "light-brown-fabric", "silver-paint", "blue-metallic-paint"]
# As the stated errors have it: what is at the rim depends on it. A sixteenth of the pixels says
# as much as all.
SIZE, EVERY = 128, 4
# What a table in place of a network, and fewer pixels, may make of difference.
ALLOWED = 0.02
# One fragment for each pair of directions, this many across and down; a map has 8192 texels.
SIDE = 128
VERTEX = f"""#version 400
in vec3 normal; in vec3 tangent; in vec3 viewer;
out VertexData {{ vec3 normalWorld; vec3 tangentWorld; vec3 positionWorld; }} vd;
void main() {{
    vd.normalWorld = normal; vd.tangentWorld = tangent; vd.positionWorld = -viewer;
    ivec2 pixel = ivec2(gl_VertexID % {SIDE}, gl_VertexID / {SIDE});
    gl_Position = vec4((vec2(pixel) + 0.5) / {SIDE / 2} - 1.0, 0.0, 1.0);
}}"""


def read_map(path):
    with OpenEXR.File(str(path)) as file:
        return file.channels()["RGB"].pixels.astype(float)


def fragment_shader(path):
    """The material's GLSL, lit by nothing but one light."""
    document = openpbr.read(path)
    generator = PyMaterialXGenGlsl.GlslShaderGenerator.create()
    context = openpbr.context_of(generator)
    options = context.getOptions()
    options.hwSpecularEnvironmentMethod = PyMaterialXGenShader.HwSpecularEnvironmentMethod.SPECULAR_ENVIRONMENT_NONE
    options.hwMaxActiveLightSources = 1
    light = openpbr.LIBRARY.getNodeDef("ND_directional_light")
    PyMaterialXGenShader.HwShaderGenerator.bindLightShader(light, 1, context)
    (material,) = document.getMaterialNodes()
    shader = generator.generate(material.getName(), material, context)
    # MaterialX 1.39.5 forgets to declare this where no environment lights the material.
    return shader.getSourceCode("pixel").replace("\n", "\nconst bool u_refractionTwoSided = false;\n", 1)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class Shaded:
    """f of a material at pairs of directions, as MaterialX has it."""

    def __init__(self, gl, fragment):
        self.gl, self.program = gl, gl.program(vertex_shader=VERTEX, fragment_shader=fragment)
        self.target = gl.framebuffer(gl.texture((SIDE, SIDE), 4, dtype="f4"))
        for name, value in {
            "u_viewPosition": (0.0, 0.0, 0.0),
            "u_numActiveLightSources": 1,
            "u_lightData[0].type": 1,
            "u_lightData[0].direction": (0.0, 0.0, -1.0),
            "u_lightData[0].color": (1.0, 1.0, 1.0),
            "u_lightData[0].intensity": 1.0,
        }.items():
            self.program[name].value = value

    def __call__(self, light, viewer):
        """Unit vectors in the frame of the surface, whose normal is +z."""
        assert len(light) <= SIDE**2
        # The shader's light is fixed, so all else is turned until the light is at +z.
        across = unit(np.cross(light, np.where(np.abs(light[:, :1]) < 0.7, [1.0, 0, 0], [0, 1.0, 0])))
        axes = np.stack([across, np.cross(light, across), light], axis=1)
        data = np.hstack([axes[:, :, 2], axes[:, :, 0], np.einsum("nij,nj->ni", axes, viewer)])
        buffer = self.gl.buffer(data.astype("f4").tobytes())
        points = self.gl.vertex_array(self.program, [(buffer, "3f 3f 3f", "normal", "tangent", "viewer")])
        self.target.use()
        self.gl.clear()
        points.render(moderngl.POINTS)
        shown = np.frombuffer(self.target.read(components=4, dtype="f4"), "f4").reshape(-1, 4)
        points.release()
        buffer.release()
        return shown[: len(light), :3] / light[:, 2:3]


gl = moderngl.create_standalone_context(backend="egl")
print(f"OpenGL: {gl.info['GL_RENDERER']}")
images, failures = [read_map(path) for path in MAPS], []
with tempfile.TemporaryDirectory() as folder:
    for name in MATERIALS:
        document, table = Path(folder) / "x.mtlx", Path(folder) / "x.binary"
        for path in (document, table):
            subprocess.run([RIG, "brdf", "convert", f"nbrdf:{name}", "--out", path], check=True, capture_output=True)
        stated = float(re.search(r"environment error ([\d.]+)%", document.read_text())[1]) / 100
        shaded, merl = Shaded(gl, fragment_shader(document)), read_merl(table)
        mean = mean_error(shaded, merl, images, SIZE, EVERY)
        passes = abs(mean - stated) <= ALLOWED
        print(f"{'ok' if passes else 'FAILED':6} {name}: environment error as MaterialX shades it {mean:.3f}, stated {stated:.3f}")
        if not passes:
            failures.append(name)

if failures:
    sys.exit(f"{len(failures)} materials differ")

"""Exported OpenPBR materials in MaterialX itself: materialx_document.py RIG_BINARY

Each document is read, validated, compared with the node's definition, and turned into code
for GLSL, OSL and MDL.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenMdl, PyMaterialXGenOsl

import openpbr

RIG = sys.argv[1]
MATERIALS = ["nbrdf:red-plastic", "nbrdf:alum-bronze", "nbrdf:light-brown-fabric"]
failures = []


def check(what, passes):
    print(f"{'ok' if passes else 'FAILED':6} {what}")
    if not passes:
        failures.append(what)


with tempfile.TemporaryDirectory() as folder:
    for spec in MATERIALS:
        path = Path(folder) / f"{spec.split(':')[1]}.mtlx"
        subprocess.run([RIG, "brdf", "convert", spec, "--out", path], check=True, capture_output=True)
        document = openpbr.read(path)
        valid, message = document.validate()
        check(f"{spec}: the document is valid {message}", valid)
        check(f"{spec}: linear Rec. 709", document.getColorSpace() == "lin_rec709")
        (surface,) = document.getNodes("open_pbr_surface")
        definition = surface.getNodeDef()
        known = {i.getName(): i.getType() for i in definition.getActiveInputs()}
        given = {i.getName(): i.getType() for i in surface.getInputs()}
        check(f"{spec}: every input is one of the node's", given.items() <= known.items())
        (material,) = document.getMaterialNodes()
        for generator in (
            PyMaterialXGenGlsl.GlslShaderGenerator.create(),
            PyMaterialXGenOsl.OslShaderGenerator.create(),
            PyMaterialXGenMdl.MdlShaderGenerator.create(),
        ):
            shader = generator.generate(material.getName(), material, openpbr.context_of(generator))
            code = shader.getSourceCode("pixel")
            check(f"{spec}: {generator.getTarget()}, {len(code)} characters", "open_pbr" in code or len(code) > 1000)

if failures:
    sys.exit(f"{len(failures)} checks failed")

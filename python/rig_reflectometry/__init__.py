"""Measures how a material reflects light, from the interreflections of a concave sample.

>>> import rig_reflectometry as rig
>>> plastic = rig.Brdf.load("nbrdf:red-plastic")
>>> plastic([0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]).shape
(3,)

=====================  ====================================================
Brdf                   load, mix, evaluate, draw, compare, write BRDFs
Scene                  scene files, rendered
merge                  exposure brackets to radiance
fit, Fit               a BRDF with its interval, from images
Session                what the program captured: frames, images, fits
RadianceImage, Table…  plain data (rig_reflectometry.records)
RigError…              what is raised (rig_reflectometry.errors)
=====================  ====================================================

Directions are unit vectors whose z is the surface's normal, lengths are millimetres, angles
degrees and named so, f is in 1/sr without the cosine, images are radiance in R, G, B with row 0
at the top. Arrays that go in are copied, because long work runs without the interpreter's lock;
arrays that come out are not.

Start other processes with multiprocessing.get_context("spawn"): the library's threads don't
survive a fork.
"""

from ._native import VERSION as __version__
from ._native import Brdf, Fit, Scene, Session, fit, merge
from .errors import (
    FileError,
    FitError,
    InputError,
    MissingFileError,
    NoFitError,
    RigError,
    SceneError,
    SessionError,
)
from .progress import ProgressBar
from .records import (
    Atom,
    Budget,
    Check,
    Errors,
    FitWarning,
    Frame,
    Merged,
    PerChannel,
    Projection,
    RadianceImage,
    Table,
)

__all__ = [
    "Atom",
    "Brdf",
    "Budget",
    "Check",
    "Errors",
    "FileError",
    "Fit",
    "FitError",
    "FitWarning",
    "Frame",
    "InputError",
    "Merged",
    "MissingFileError",
    "NoFitError",
    "PerChannel",
    "ProgressBar",
    "Projection",
    "RadianceImage",
    "RigError",
    "Scene",
    "SceneError",
    "Session",
    "SessionError",
    "Table",
    "__version__",
    "fit",
    "merge",
]

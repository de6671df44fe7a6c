"""Measures how a material reflects light, from the interreflections of a concave sample.

>>> import rig_reflectometry as rig
>>> plastic = rig.Brdf.load("nbrdf:red-plastic")
>>> plastic([0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]).shape
(3,)

=====================  ====================================================
Brdf                   load, mix, evaluate, draw, compare, write BRDFs
materials              names of the measured materials that come with it
Scene                  a camera, lights and a sample, from a file or arrays; rendered
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
survive a fork. BRDFs, scenes, images, fits and sessions can be sent to them.
"""

from ._native import VERSION as __version__
from ._native import Brdf, Fit, Scene, Session, fit, materials, merge
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
    Camera,
    Check,
    Errors,
    FitWarning,
    Frame,
    Interval,
    Light,
    Merged,
    Mesh,
    PerChannel,
    Projection,
    RadianceImage,
    Table,
)

__all__ = [
    "Atom",
    "Brdf",
    "Budget",
    "Camera",
    "Check",
    "Errors",
    "FileError",
    "Fit",
    "FitError",
    "FitWarning",
    "Frame",
    "InputError",
    "Interval",
    "Light",
    "Merged",
    "Mesh",
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
    "materials",
    "merge",
]

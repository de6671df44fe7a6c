"""Plain data that the package takes and gives."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ._native import Brdf


@dataclass(frozen=True, eq=False)
class RadianceImage:
    """Radiance over a grid of pixels, R, G, B; row 0 is the top.

    What is masked in a masked array is not valid.
    """

    mean: NDArray[np.float32]
    """(rows, columns, 3); negative values are kept."""
    variance: NDArray[np.float32] | None = None
    """Of each mean, (rows, columns, 3); None where it is not known."""
    valid: NDArray[np.bool_] | None = None
    """(rows, columns); False where a pixel holds no information. None: all are valid."""

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RadianceImage:
        """Read an OpenEXR file with channels R, G, B and, where known, var.R, var.G, var.B, mask.

        FILE.exr:NAME names one of several images. Raises MissingFileError or FileError.
        """
        from ._native import read_exr

        return read_exr(path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an OpenEXR file, whole or not at all. Raises InputError or FileError."""
        from ._native import write_exr

        write_exr(path, self)


@dataclass(frozen=True)
class Atom:
    """One closed form of a dictionary."""

    kind: str
    """"ggx", "beckmann", "lambertian", "black", …"""
    alpha: float | None = None
    """Roughness of its lobe (Walter et al. 2007)."""
    eta: float | None = None
    """Index of refraction relative to air."""
    albedo: float | None = None
    """Diffuse albedo."""


@dataclass(frozen=True, eq=False)
class Table:
    """f over half angle (H values) and difference angle (D values), with its 95% interval.

    At a difference azimuth of 90°, where every pair of angles exists.
    """

    theta_h_deg: NDArray[np.float64]
    """(H,), degrees."""
    theta_d_deg: NDArray[np.float64]
    """(D,), degrees."""
    value: NDArray[np.float64]
    """(H, D, 3), 1/sr."""
    lower: NDArray[np.float64]
    """(H, D, 3), 1/sr."""
    upper: NDArray[np.float64]
    """(H, D, 3), 1/sr."""
    constrained: NDArray[np.bool_]
    """(H, D): whether the images determine f there, or only the prior does."""


@dataclass(frozen=True, eq=False)
class Budget:
    """Where the interval of f comes from, at K pairs of angles and by S sources."""

    sources: list[str]
    """Names of the S sources."""
    theta_h_deg: NDArray[np.float64]
    """(K,), degrees."""
    theta_d_deg: NDArray[np.float64]
    """(K,), degrees."""
    value: NDArray[np.float64]
    """(K,), mean over the channels, 1/sr."""
    relative_std: NDArray[np.float64]
    """(K,): standard deviation of f over f, all sources together."""
    share: NDArray[np.float64]
    """(K, S): part of the variance by source; rows sum to 1."""


@dataclass(frozen=True)
class FitWarning:
    """A reason not to trust a fit, or not in everything."""

    what: str
    """The fact."""
    likely_cause: str
    """Its most likely cause."""
    grade: str
    """"reservation" or "distrust"."""


@dataclass(frozen=True)
class PerChannel:
    """An error over all channels, and in each."""

    all: float
    red: float
    green: float
    blue: float


@dataclass(frozen=True)
class Errors:
    """How far a BRDF is from a known truth; relative, dimensionless."""

    environment: PerChannel
    """Spheres under four environment maps: mean of ‖a − b‖ / ‖b‖."""
    maps: dict[str, float]
    """The same by map, over all channels."""
    brdf: PerChannel
    """‖cos θi (f − f̂)‖ / ‖cos θi f‖ over MERL's cells."""
    cube_root: PerChannel
    """The same cells, mean |∛a − ∛b| over mean ∛b with a = cos θi f."""


@dataclass(frozen=True, eq=False)
class Projection:
    """What a dictionary can reach of a BRDF."""

    brdf: Brdf
    """The mixture with the least cube-root error."""
    errors: Errors
    """Its errors."""
    floor: Errors
    """The least value of each error that any weights reach."""


@dataclass(frozen=True, eq=False)
class Check:
    """Whether a BRDF is physical."""

    passes: bool
    """Reciprocal within 1%, reflects no more than arrives, no bad values."""
    reciprocity: float
    """Largest relative difference of f(wi, wo) and f(wo, wi)."""
    largest_albedo: float
    """Largest directional albedo; 1 is all light reflected."""
    theta_deg: NDArray[np.float64]
    """(N,), polar angles of the light, degrees."""
    albedo: NDArray[np.float64]
    """(N, 3), directional albedo there."""
    invalid: int
    """Pairs of directions with a negative, infinite or undefined value."""


@dataclass(frozen=True)
class Frame:
    """A raw frame of a session."""

    light: int
    """Index of the light direction."""
    exposure: int
    """Index of the exposure in its bracket."""
    repeat: int
    """Repeat at the same settings."""
    kind: str
    """"light", "ambient" or "dark"."""
    file: str
    """16-bit PNG, relative to the session."""


@dataclass(frozen=True, eq=False)
class Merged:
    """A merged bracket."""

    image: RadianceImage
    """The radiance image."""
    masked_pixels: int
    """Pixels that are not valid: clipped in every exposure, hot, or moving."""
    agreement: list[list[dict[str, Any]]]
    """How the exposures agree, per channel of the frames, shortest first; as in `rig merge --json`."""
    exposures: list[dict[str, Any]]
    """With measured_exposures, each exposure as stated and as used (s) with its relative standard
    uncertainty, shortest first; else empty. `rig merge --json` calls them `measured_exposures`."""

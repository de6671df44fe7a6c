"""Plain data that the package takes and gives."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from ._native import Brdf


def _frame(columns):
    """A pandas.DataFrame; pandas is not needed for anything else."""
    try:
        import pandas
    except ImportError as error:
        message = "to_pandas() needs the package pandas, for instance by: pip install pandas"
        raise ImportError(message) from error
    return pandas.DataFrame(columns)


def _stated(record):
    """The repr of a record's fields that are not None, arrays as lists."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    shown = [f"{name}={np.asarray(value).tolist()}" for name, value in values.items() if value is not None]
    return f"{type(record).__name__}({', '.join(shown)})"


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        rows, columns = np.shape(self.mean)[:2]
        known = "without" if self.variance is None else "with"
        bad = 0 if self.valid is None else np.size(self.valid) - np.count_nonzero(self.valid)
        masked = f", {bad} px not valid" if bad else ""
        return f"RadianceImage({columns} x {rows} px, {known} variance{masked})"

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


@dataclass(frozen=True, eq=False, repr=False)
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

    def to_pandas(self) -> Any:
        """A pandas.DataFrame, a row for each pair of angles, with the columns of table.csv.

        Raises ImportError without the package pandas.
        """
        half, difference = np.meshgrid(self.theta_h_deg, self.theta_d_deg, indexing="ij")
        columns = {"theta_h_deg": half.ravel(), "theta_d_deg": difference.ravel()}
        for name, values in [("f", self.value), ("lower", self.lower), ("upper", self.upper)]:
            for index, channel in enumerate("rgb"):
                columns[f"{name}_{channel}"] = values[..., index].ravel()
        return _frame(columns | {"constrained": self.constrained.ravel()})

    def __repr__(self) -> str:
        half, difference = np.shape(self.constrained)
        constrained = np.count_nonzero(self.constrained)
        return f"Table({half} half x {difference} difference angles, {constrained} constrained)"


@dataclass(frozen=True, eq=False, repr=False)
class Interval:
    """f with its 95% interval at angles of your own, whose shape is (...)."""

    value: NDArray[np.float64]
    """(..., 3), 1/sr."""
    lower: NDArray[np.float64]
    """(..., 3), 1/sr."""
    upper: NDArray[np.float64]
    """(..., 3), 1/sr."""
    constrained: NDArray[np.bool_]
    """(...): whether the images determine f there, or only the prior does."""

    def __repr__(self) -> str:
        angles, constrained = np.size(self.constrained), np.count_nonzero(self.constrained)
        if angles != 1:
            return f"Interval({angles} pairs of angles, {constrained} constrained)"
        f = [f"{value:.3g}" for value in np.ravel([self.value, self.lower, self.upper])]
        rows = {"value": f[:3], "lower": f[3:6], "upper": f[6:]}
        shown = ", ".join(f"{name}=[{', '.join(row)}]" for name, row in rows.items())
        return f"Interval({shown}, constrained={constrained == 1})"


@dataclass(frozen=True, eq=False, repr=False)
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

    @property
    def not_evaluated(self) -> list[str]:
        """Sources that the fit took as exactly known: their share is 0 everywhere."""
        pairs = zip(self.sources, self.share.T, strict=True)
        return [name for name, share in pairs if not share.any()]

    def to_pandas(self) -> Any:
        """A pandas.DataFrame, a row for each pair of angles and a column for each source.

        What is not evaluated is NaN. Raises ImportError without the package pandas.
        """
        columns = {
            name: getattr(self, name)
            for name in ("theta_h_deg", "theta_d_deg", "value", "relative_std")
        }
        shares = dict(zip(self.sources, self.share.T, strict=True))
        return _frame(columns | shares | dict.fromkeys(self.not_evaluated, np.nan))

    def __repr__(self) -> str:
        unknown = self.not_evaluated
        sources = [name for name in self.sources if name not in unknown]
        tail = f"; not evaluated: {', '.join(unknown)}" if unknown else ""
        return f"Budget({len(self.value)} pairs of angles, sources: {', '.join(sources)}{tail})"


@dataclass(frozen=True)
class FitWarning:
    """A reason not to trust a fit, or not in everything."""

    what: str
    """The fact."""
    likely_cause: str
    """Its most likely cause."""
    grade: str
    """"reservation" or "distrust"."""


@dataclass(frozen=True, repr=False)
class PerChannel:
    """An error over all channels, and in each."""

    all: float
    red: float
    green: float
    blue: float

    def __repr__(self) -> str:
        channels = f"red={self.red:.3g}, green={self.green:.3g}, blue={self.blue:.3g}"
        return f"PerChannel(all={self.all:.3g}, {channels})"


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        named = {"environment": self.environment, "brdf": self.brdf, "cube_root": self.cube_root}
        errors = ", ".join(f"{name}={error.all:.3g}" for name, error in named.items())
        return f"Errors({errors})"


@dataclass(frozen=True, eq=False)
class Projection:
    """What a dictionary can reach of a BRDF."""

    brdf: Brdf
    """The mixture with the least cube-root error."""
    errors: Errors
    """Its errors."""
    floor: Errors
    """The least value of each error that any weights reach."""


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        found = f"reciprocity={self.reciprocity:.3g}, largest_albedo={self.largest_albedo:.3g}"
        return f"Check(passes={self.passes}, {found}, invalid={self.invalid})"


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


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        return f"Merged({self.image!r}, masked_pixels={self.masked_pixels})"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Camera:
    """A camera in the sample's frame: with extent_mm telecentric, with fov_deg a pinhole's view.

    What is None is as the scene file has it where it says nothing. Row 0 of its images is the top.
    """

    resolution_px: ArrayLike
    """Width and height of the images, pixels."""
    position_mm: ArrayLike
    """(3,)."""
    extent_mm: ArrayLike | None = None
    """Width and height of the field of view; orthographic."""
    fov_deg: float | None = None
    """Full angle of view across the image's width; perspective."""
    look_at_mm: ArrayLike | None = None
    """(3,), in the middle of the image; the origin if None."""
    up: ArrayLike | None = None
    """(3,), up in the image; +y if None."""
    object_na: float | None = None
    """Sine of the half angle of the cone of rays that meet in a sharp point; 0 is a pinhole."""
    focus_mm: float | None = None
    """Distance at which the image is sharp; that of look_at_mm if None."""
    point_spread_px: float | None = None
    """Standard deviation of the spread of a point in focus."""
    principal_point_px: ArrayLike | None = None
    """Where the lens' axis meets the image; the middle if None."""
    pixel_aspect: float | None = None
    """How much taller the image is than the projection says."""
    radial: ArrayLike | None = None
    """(3,), distortion k1, k2, k3."""
    tangential: ArrayLike | None = None
    """(2,), distortion p1, p2."""

    __repr__ = _stated


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Light:
    """A light far away, with to_light, or a small lamp, with position_mm and intensity."""

    to_light: ArrayLike | None = None
    """(3,), from the sample to the light, of any length."""
    irradiance: ArrayLike | None = None
    """On a plane that faces the light, one number or R, G, B; 1 if None."""
    angular_radius_deg: float | None = None
    """Of the lamp, as seen from the sample; 0 if None."""
    position_mm: ArrayLike | None = None
    """(3,)."""
    intensity: ArrayLike | None = None
    """Irradiance × mm², one number or R, G, B."""

    __repr__ = _stated


@dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """A surface of triangles in the sample's frame.

    Seen from its front, from which it reflects, a triangle's corners run counter-clockwise.
    """

    vertices_mm: ArrayLike
    """(V, 3)."""
    triangles: ArrayLike
    """(T, 3), indices of vertices."""
    normals: ArrayLike | None = None
    """(V, 3), for smooth shading; None: made of the facets where they are needed."""

    def __repr__(self) -> str:
        normals = "" if self.normals is None else ", with normals"
        vertices, triangles = np.shape(self.vertices_mm)[0], np.shape(self.triangles)[0]
        return f"Mesh({vertices} vertices, {triangles} triangles{normals})"

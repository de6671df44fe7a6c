"""What the compiled module has; its own docstrings say more (`help(rig.Brdf)`)."""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Unpack

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
    Projection,
    RadianceImage,
    Table,
)

VERSION: str

_Path: TypeAlias = str | PathLike[str]
_Progress: TypeAlias = Callable[[str, int, int | None], object]
_Optimizer: TypeAlias = Literal["gauss-newton", "exponentiated-gradient", "single-bounce"]
_Kernel: TypeAlias = Literal["portable", "avx2", "avx512", "auto"]

class _FitOptions(TypedDict, total=False):
    dictionary: _Path | None
    optimizer: _Optimizer | None
    spp: int | None
    max_reflections: int | None
    seed: int | None
    shared_weights: bool | None
    model_error: float | None
    mask: _Path | None
    cells: int | None
    memory: int | None
    kernel: _Kernel | None
    refine_bench: bool | None
    uncertainty: Mapping[str, float] | None
    leave_out: Sequence[str] | None
    samples_per_cell: int | None  # spp
    memory_mib: int | None  # memory

_Mosaic: TypeAlias = Literal["none", "rggb", "grbg", "gbrg", "bggr"]
_Format: TypeAlias = Literal[
    "json", "merl", "rgl", "rgl-spectral", "mitsuba", "pbrt", "openpbr", "blender", "gltf", "birdf"
]

@final
class Brdf:
    @staticmethod
    def load(spec: _Path) -> Brdf: ...
    @staticmethod
    def mixture(
        dictionary: _Path | Sequence[Atom], weights: ArrayLike, *, name: str | None = None
    ) -> Brdf: ...
    @property
    def name(self) -> str: ...
    @property
    def atoms(self) -> list[Atom] | None: ...
    @property
    def weights(self) -> NDArray[np.float64] | None: ...
    def __call__(self, wi: ArrayLike, wo: ArrayLike) -> NDArray[np.float32]: ...
    def at(
        self, theta_i_deg: ArrayLike, theta_o_deg: ArrayLike, phi_deg: ArrayLike
    ) -> NDArray[np.float32]: ...
    def table(self, theta_h_deg: ArrayLike, theta_d_deg: ArrayLike) -> NDArray[np.float32]: ...
    def environment_sphere(self, map: _Path = "studio", size: int = 128) -> NDArray[np.float32]: ...
    def spheres(self, size: int = 256) -> NDArray[np.uint8]: ...
    def errors(self, truth: Brdf, *, size: int = 128) -> Errors: ...
    def project(self, dictionary: str = "rig65", *, size: int = 128) -> Projection: ...
    def check(self) -> Check: ...
    def save(self, path: _Path) -> None: ...

@final
class Scene:
    def __init__(
        self,
        camera: Camera,
        lights: ArrayLike | Sequence[Light],
        sample: Mesh | Mapping[str, Any] | _Path,
        *,
        irradiance: ArrayLike | None = None,
        shading: Literal["flat", "smooth"] = "flat",
        folder: _Path = ".",
        **tables: Any,
    ) -> None: ...
    @staticmethod
    def load(path: _Path) -> Scene: ...
    @staticmethod
    def parse(text: str, folder: _Path = ".") -> Scene: ...
    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def lights(self) -> list[Light]: ...
    @property
    def mesh(self) -> Mesh: ...
    @property
    def shading(self) -> Literal["flat", "smooth"]: ...
    @property
    def brdf(self) -> Brdf | None: ...
    def render(
        self,
        brdf: Brdf | None = None,
        *,
        spp: int | None = None,
        max_reflections: int = ...,
        seed: int = ...,
        polarised: bool | None = None,
        progress: _Progress | None = None,
        samples_per_pixel: int | None = None,
    ) -> list[RadianceImage]: ...

@final
class Fit:
    @staticmethod
    def load(folder: _Path) -> Fit: ...
    @property
    def brdf(self) -> Brdf: ...
    @property
    def mixture(self) -> Brdf: ...
    @property
    def dictionary(self) -> str: ...
    @property
    def atoms(self) -> list[Atom]: ...
    @property
    def weights(self) -> NDArray[np.float64]: ...
    @property
    def weight_deviations(self) -> NDArray[np.float64]: ...
    @property
    def table(self) -> Table: ...
    def interval(
        self, theta_h_deg: ArrayLike, theta_d_deg: ArrayLike, phi_d_deg: ArrayLike | None = None
    ) -> Interval: ...
    @property
    def verdict(self) -> Literal["explains", "reservations", "not-to-be-trusted"]: ...
    @property
    def warnings(self) -> list[FitWarning]: ...
    @property
    def remarks(self) -> list[str]: ...
    @property
    def reduced_chi_square(self) -> NDArray[np.float64]: ...
    @property
    def loss(self) -> float: ...
    @property
    def trace(self) -> NDArray[np.float64]: ...
    @property
    def discrepancy(self) -> float: ...
    @property
    def budget(self) -> Budget | None: ...
    @property
    def record(self) -> dict[str, Any]: ...
    @property
    def simulated(self) -> bool: ...
    def rendered(self) -> list[RadianceImage]: ...
    def residual(self) -> list[RadianceImage]: ...
    def deviations(
        self,
        scene: Scene | _Path,
        *,
        max_reflections: int = ...,
        seed: int = ...,
        progress: _Progress | None = None,
    ) -> list[NDArray[np.float32]]: ...
    def save(self, folder: _Path) -> None: ...
    def export(self, path: _Path, format: _Format) -> list[Path]: ...

@final
class Session:
    def __init__(self, root: _Path) -> None: ...
    @property
    def path(self) -> Path: ...
    @property
    def sample(self) -> str: ...
    @property
    def simulated(self) -> bool: ...
    @property
    def complete(self) -> bool: ...
    @property
    def record(self) -> dict[str, Any]: ...
    @property
    def lights_deg(self) -> NDArray[np.float64]: ...
    @property
    def frames(self) -> list[Frame]: ...
    def read_frame(self, frame: Frame) -> tuple[NDArray[np.uint16], dict[str, Any]]: ...
    def radiance(self, light: int) -> RadianceImage: ...
    @property
    def fits(self) -> list[Fit]: ...
    @property
    def latest_fit(self) -> Fit: ...
    def fit(
        self,
        *,
        pose: _Path | None = None,
        progress: _Progress | None = None,
        **options: Unpack[_FitOptions],
    ) -> Fit: ...

def fit(
    scene: Scene | _Path,
    images: Sequence[RadianceImage | ArrayLike | _Path],
    *,
    out: _Path | None = None,
    progress: _Progress | None = None,
    **options: Unpack[_FitOptions],
) -> Fit: ...
def merge(
    frames: _Path | Sequence[_Path],
    *,
    exposures: _Path | None = None,
    gain: float | None = None,
    read_noise: float | None = None,
    black_level: float | None = None,
    saturation: float | None = None,
    bit_depth: int | None = None,
    dark_current: float = 0.0,
    responsivity: float = 1.0,
    response: _Path | None = None,
    mosaic: _Mosaic = "none",
    full_resolution: bool = False,
    measured_exposures: bool = False,
    out: _Path | None = None,
    progress: _Progress | None = None,
) -> Merged: ...
def materials() -> list[str]: ...
def read_exr(path: _Path) -> RadianceImage: ...
def write_exr(path: _Path, image: RadianceImage | ArrayLike) -> None: ...

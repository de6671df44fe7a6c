"""What arrays say of a scene, as a scene file says it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from .errors import InputError
from .records import Camera, Light, Mesh


def describe(camera, lights, sample, irradiance, shading, tables):
    """The text of a scene file; that of a Mesh has a sphere in its place."""
    if not isinstance(camera, Camera):
        raise TypeError(f"camera is a {type(camera).__name__}; a Camera is needed")
    model = "perspective" if camera.fov_deg is not None else "orthographic"
    scene = {
        "camera": {"model": model} | _stated(camera),
        "light": [_light(light) for light in _lights(lights, irradiance)],
        "sample": {"shading": shading} | _surface(sample),
    }
    for name in scene.keys() & (tables or {}).keys():
        raise TypeError(f"{name} is not among the further tables of a scene")
    return "".join(f"{key} = {_toml(value)}\n" for key, value in (scene | (tables or {})).items())


def _stated(record):
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {name: value for name, value in values.items() if value is not None}


def _lights(lights, irradiance):
    """A Light for each."""
    if not isinstance(lights, np.ndarray) and any(isinstance(light, Light) for light in lights):
        if irradiance is not None:
            raise InputError("irradiance is for lights that are directions; each Light has its own")
        return lights
    directions = np.asarray(lights)
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise InputError(f"lights has shape {directions.shape}, but must be (L, 3)")
    try:
        values = np.broadcast_to(1.0 if irradiance is None else irradiance, directions.shape)
    except ValueError:
        message = f"irradiance has shape {np.shape(irradiance)}, which is not broadcast to "
        raise InputError(message + str(directions.shape)) from None
    pairs = zip(directions, values, strict=True)
    return [Light(to_light=to_light, irradiance=value) for to_light, value in pairs]


def _light(light):
    if not isinstance(light, Light):
        raise TypeError(f"a light is a {type(light).__name__}; a Light is needed")
    return {"kind": "directional" if light.position_mm is None else "point"} | _stated(light)


def _surface(sample):
    if isinstance(sample, Mesh):
        return {"shape": {"kind": "sphere", "radius_mm": 1.0}}
    if isinstance(sample, Mapping):
        return {"shape": sample}
    return {"mesh": sample}


def _toml(value):
    """A value of TOML in one line."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | os.PathLike):
        return json.dumps(os.fspath(value), ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml(str(key))} = {_toml(v)}" for key, v in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(map(_toml, value)) + "]"
    raise TypeError(f"a scene has no place for a {type(value).__name__}")

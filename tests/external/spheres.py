"""Spheres of a MERL table under a latitude-longitude map, by plain sums over its texels.

Written from the descriptions of both formats, so that renders of other programs have
something to be compared with that is not rig's own code.
"""

import struct

import numpy as np

SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0


def read_merl(path):
    """f in 1/sr, indexed by half angle, difference angle, azimuth, channel."""
    data = open(path, "rb").read()
    shape = struct.unpack("<3i", data[:12])
    values = np.frombuffer(data[12:], "<f8").reshape(3, *shape)
    return np.maximum(np.moveaxis(values, 0, -1) * SCALE, 0.0)


def merl_lookup(table, light, viewer):
    """f at unit vectors in the frame of the surface (normal +z), trilinear."""
    half = light + viewer
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    theta_h = np.arccos(np.clip(half[..., 2], -1, 1))
    phi_h = np.arctan2(half[..., 1], half[..., 0])
    # The light turned so that the half vector is the pole.
    c, s = np.cos(-phi_h), np.sin(-phi_h)
    x = c * light[..., 0] - s * light[..., 1]
    y = s * light[..., 0] + c * light[..., 1]
    z = light[..., 2]
    c, s = np.cos(-theta_h), np.sin(-theta_h)
    x, z = c * x + s * z, -s * x + c * z
    theta_d = np.arccos(np.clip(z, -1, 1))
    phi_d = np.arctan2(y, x) % np.pi
    n_h, n_d, n_p = table.shape[:3]
    position = [
        np.clip(np.sqrt(theta_h / (np.pi / 2)) * n_h, 0, n_h - 1),
        np.clip(theta_d / (np.pi / 2) * n_d, 0, n_d - 1),
        phi_d / np.pi * n_p,
    ]
    low = [np.floor(p).astype(int) for p in position]
    part = [p - l for p, l in zip(position, low)]
    total = 0.0
    for corner in range(8):
        index, weight = [], 1.0
        for axis, (l, t, n) in enumerate(zip(low, part, (n_h, n_d, n_p))):
            up = corner >> axis & 1
            index.append((l + up) % n if axis == 2 else np.minimum(l + up, n - 1))
            weight = weight * (t if up else 1 - t)
        total = total + weight[..., None] * table[tuple(index)]
    return total


def texels(height, width):
    """Directions (+y up, the middle column at -z, columns towards +x) and solid angles."""
    v = (np.arange(height) + 0.5) / height
    u = (np.arange(width) + 0.5) / width
    sin, cos = np.sin(np.pi * v)[:, None], np.cos(np.pi * v)[:, None]
    phi = 2 * np.pi * (u - 0.5)[None, :]
    directions = np.stack([sin * np.sin(phi), cos + 0 * phi, -sin * np.cos(phi)], axis=-1)
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    solid = (edges[:-1] - edges[1:]) * 2 * np.pi / width
    return directions.reshape(-1, 3), np.repeat(solid, width)


def finer(image, factor):
    """Bilinear between texel centres; the columns close in a ring."""
    height, width, _ = image.shape
    y = np.clip((np.arange(height * factor) + 0.5) / factor - 0.5, 0, height - 1)
    x = (np.arange(width * factor) + 0.5) / factor - 0.5
    y0, x0 = np.floor(y).astype(int), np.floor(x).astype(int)
    ty, tx = (y - y0)[:, None, None], (x - x0)[None, :, None]
    y1 = np.minimum(y0 + 1, height - 1)
    rows = lambda y: image[y][:, x0 % width] * (1 - tx) + image[y][:, (x0 + 1) % width] * tx
    return rows(y0) * (1 - ty) + rows(y1) * ty


def normals(size):
    """Pixels on a sphere seen along -z, row 0 at the top, and the normals there."""
    at = (2 * np.arange(size) + 1) / size - 1
    x, y = np.meshgrid(at, -at)
    inside = x**2 + y**2 < 1
    return inside, np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)


def sphere(reflect, image, size, factor=2, every=1):
    """Pixels on a sphere and their radiance; `reflect(light, viewer)` is f in the frame of the
    surface. Only every so many rows and columns: the others count as beside the sphere."""
    image = finer(image, factor)
    directions, solid = texels(*image.shape[:2])
    arriving = image.reshape(-1, 3) * solid[:, None]
    on_sphere, all_normals = normals(size)
    inside = np.zeros_like(on_sphere)
    inside[::every, ::every] = on_sphere[::every, ::every]
    out = np.zeros((size, size, 3))
    for row, column in zip(*np.nonzero(inside)):
        n = all_normals[row, column]
        tangent = np.array([0, 0, 1.0]) - n * n[2]
        length = np.linalg.norm(tangent)
        tangent = tangent / length if length > 1e-9 else np.array([1.0, 0, 0])
        frame = np.stack([tangent, np.cross(n, tangent), n])
        local = directions @ frame.T
        up = local[:, 2] > 0
        viewer = np.broadcast_to(frame @ np.array([0, 0, 1.0]), local[up].shape)
        f = reflect(local[up], viewer)
        out[row, column] = (f * arriving[up] * local[up][:, 2:3]).sum(axis=0)
    return inside, out


def error(a, b):
    """Relative difference of two images."""
    return np.sqrt(((a - b) ** 2).sum() / (b**2).sum())


def error_without_noise(one, other, b):
    """The same of an image that was rendered twice, with different noise, which cancels."""
    return np.sqrt(max(((one - b) * (other - b)).sum(), 0) / (b**2).sum())


def mean_error(reflect, measured, images, size, every=1):
    """Error of spheres of `reflect` against those of a measured MERL table, mean of the maps;
    their texels are taken as they are."""
    errors = []
    for image in images:
        _, truth = sphere(lambda l, v: merl_lookup(measured, l, v), image, size, 1, every)
        _, there = sphere(reflect, image, size, 1, every)
        errors.append(error(there, truth))
    return float(np.mean(errors))

"""Terrain made by rule, for volume and for what the measured tiles lack."""

import numpy as np
from numpy.random import Generator

from nnpp_edge.runtime.arrays import Float2D


def fractal(
    rng: Generator,
    size: int,
    cell_size_m: float,
    median_slope_deg: float,
) -> Float2D:
    """Rough ground whose heights have a power-law spectrum: (size, size) float32, metres.

    The exponent is drawn from 2.6 to 3.8; heights are scaled to the median slope asked for.
    """
    exponent = rng.uniform(2.6, 3.8)
    fy = np.fft.fftfreq(2 * size)[:, None]
    fx = np.fft.rfftfreq(2 * size)[None]
    frequency = np.hypot(fy, fx)
    frequency[0, 0] = np.inf
    noise = rng.normal(size=(2, *frequency.shape))
    spectrum = (noise[0] + 1j * noise[1]) * frequency ** (-exponent / 2.0)
    # made at twice the size, as the whole would wrap around
    heights = np.fft.irfft2(spectrum)[:size, :size]
    median = np.median(np.hypot(*np.gradient(heights, cell_size_m)))
    gain = np.tan(np.radians(median_slope_deg)) / max(median, 1e-12)
    return np.asarray(heights * gain, np.float32)


def add_craters(
    rng: Generator,
    heights: Float2D,
    cell_size_m: float,
    count: int,
) -> Float2D:
    """`heights` with craters: parabolic bowls with raised rims and ejecta that thin out with
    distance.
    """
    size = heights.shape[0]
    out = heights.copy()
    y, x = np.mgrid[:size, :size].astype(np.float32)
    for _ in range(count):
        largest = max(size / 5, 3.0)
        radius = float(np.exp(rng.uniform(np.log(3.0), np.log(largest))))
        cy, cx = rng.uniform(0, size, 2)
        # fresh craters are a fifth as deep as wide
        depth = rng.uniform(0.08, 0.22) * 2.0 * radius * cell_size_m
        rim = 0.2 * depth
        d = np.hypot(y - cy, x - cx) / radius
        bowl = (depth + rim) * d**2 - depth
        ejecta = rim * np.maximum(d, 1.0) ** -3
        out += np.where(d < 1.0, bowl, np.where(d < 4.0, ejecta, 0.0)).astype(np.float32)
    return out


def synthetic_terrain(rng: Generator, size: int, cell_size_m: float) -> Float2D:
    """A square of fractal ground with craters on most: (size, size) float32, metres."""
    ground = fractal(rng, size, cell_size_m, rng.uniform(3.0, 12.0))
    if rng.random() < 0.7:
        ground = add_craters(rng, ground, cell_size_m, int(rng.integers(1, 30)))
    return ground

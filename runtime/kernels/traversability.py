"""Slope, roughness and elevation difference of each cell, and its cost. See `terrain.traversability`."""

import math

import numpy as np

from nnpp_edge.runtime.compiled.kernel import kernel


@kernel
def _plane(dem, row, col, dy, dx):
    """Slope (rad), roughness and elevation difference of one known cell, from the known cells of its patch."""
    rows, cols = dem.shape
    here = np.float64(dem[row, col])
    n = 0.0
    sx = sy = sz = sxx = sxy = syy = sxz = syz = szz = 0.0
    for i in range(max(row - 1, 0), min(row + 2, rows)):
        for j in range(max(col - 1, 0), min(col + 2, cols)):
            z = np.float64(dem[i, j]) - here
            if math.isnan(z) or math.isinf(z):
                continue
            x, y = (j - col) * dx, (i - row) * dy
            n += 1.0
            sx += x
            sy += y
            sz += z
            sxx += x * x
            sxy += x * y
            syy += y * y
            sxz += x * z
            syz += y * z
            szz += z * z
    # moments about the patch's mean point
    sxx -= sx * sx / n
    sxy -= sx * sy / n
    syy -= sy * sy / n
    sxz -= sx * sz / n
    syz -= sy * sz / n
    szz -= sz * sz / n
    determinant = sxx * syy - sxy * sxy
    trace = sxx + syy
    if determinant > 1e-9 * trace * trace:
        a = (sxz * syy - syz * sxy) / determinant
        b = (syz * sxx - sxz * sxy) / determinant
    elif trace > 0.0:  # all points on one line: the gradient of least length, which runs along it
        a, b = sxz / trace, syz / trace
    else:  # a single point
        a = b = 0.0
    steepness = math.sqrt(a * a + b * b)
    upright = 1.0 / math.sqrt(1.0 + steepness * steepness)
    residual = max(szz - a * sxz - b * syz, 0.0)
    own = (0.0 - sz / n) + a * sx / n + b * sy / n
    return math.atan(steepness), math.sqrt(residual / n) * upright, abs(own) * upright


@kernel
def fill_cost(dem, dy, dx, limits, area, cost, saturated):
    """Fill a rectangle of `cost`; count known cells and those that saturate each term."""
    row0, row1, col0, col1 = area
    for row in range(row0, row1):
        for col in range(col0, col1):
            z = dem[row, col]
            if math.isnan(z) or math.isinf(z):
                cost[row, col] = np.inf
                continue
            slope, roughness, step = _plane(dem, row, col, dy, dx)
            s = min(slope / limits[0], 1.0)
            r = min(roughness / limits[1], 1.0)
            f = min(step / limits[2], 1.0)
            saturated[0] += 1
            saturated[1] += s >= 1.0
            saturated[2] += r >= 1.0
            saturated[3] += f >= 1.0
            beyond = slope > limits[6] or roughness > limits[7] or step > limits[8]
            if beyond or (s >= 1.0 and r >= 1.0 and f >= 1.0):
                cost[row, col] = np.inf
            else:
                cost[row, col] = limits[3] * s + limits[4] * r + limits[5] * f


@kernel
def fill_terms(dem, dy, dx, out):
    """Slope, roughness and elevation difference of each cell into `out`; NaN where unknown."""
    for row in range(dem.shape[0]):
        for col in range(dem.shape[1]):
            z = dem[row, col]
            if math.isnan(z) or math.isinf(z):
                out[:, row, col] = np.nan
            else:
                out[0, row, col], out[1, row, col], out[2, row, col] = _plane(dem, row, col, dy, dx)

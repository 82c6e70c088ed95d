"""Rocks on terrain: numbers by the published law, heights cell by cell, and bad input."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.terrain.rocks import Rocks, covered_share, draw_rocks, rock_heights, with_rocks
from tests.tables import cases, keywords

SIDES = (0.25, 0.25)


def hills(rows=60, cols=50):
    row, col = np.mgrid[:rows, :cols]
    return (np.sin(row / 7.0) * np.cos(col / 9.0)).astype(np.float32)


def test_numbers_and_covered_ground_follow_the_law():
    for cover, (least, greatest) in itertools.product(
        (0.02, 0.05, 0.1, 0.2),
        ((0.1, 3.0), (0.5, 1.0)),
    ):
        q = 1.79 + 0.152 / cover

        def density(diameter, cover=cover, q=q):
            return cover * q * math.exp(-q * diameter) * 4.0 / (math.pi * diameter**2)

        expected = quad(density, least, greatest, epsabs=0.0)[0]
        side = math.ceil(math.sqrt(20_000 / max(expected, 1e-4)))  # metres; some 20,000 rocks
        drawn = draw_rocks((side, side), (1.0, 1.0), cover, 1, (least, greatest))
        area = float(side**2)
        assert len(drawn.places) == pytest.approx(
            expected * area,
            abs=4.0 * math.sqrt(expected * area),
        )
        assert least <= drawn.diameters_m.min() and drawn.diameters_m.max() <= greatest
        ground = 0.25 * math.pi * drawn.diameters_m**2
        wanted = float(covered_share(cover, least) - covered_share(cover, greatest)) * area
        assert ground.sum() == pytest.approx(wanted, abs=4.0 * math.sqrt((ground**2).sum()))


def test_a_rock_raises_the_cells_that_it_touches_by_its_greatest_height_over_each():
    rng = np.random.default_rng(0)
    sides = (0.25, 0.4)
    share = (np.arange(41) - 20) / 40.0
    for diameter in (0.1, 0.24, 0.3, 0.9, 2.0):
        place = rng.uniform(-0.5, 11.5, (1, 2))
        found = rock_heights((12, 12), sides, Rocks(place, np.array([diameter])))
        down = (np.arange(12)[:, None] + share - place[0, 0]) * sides[0]
        across = (np.arange(12)[:, None] + share - place[0, 1]) * sides[1]
        away = np.hypot(down[:, None, :, None], across[None, :, None, :])
        rest = (0.5 * diameter) ** 2 - away**2
        sampled = np.sqrt(np.maximum(rest, 0.0)).max((2, 3))
        assert (found >= sampled - 1e-6).all()  # the samples miss a cell that is barely touched
        assert found[sampled > 0.1 * diameter] == pytest.approx(
            sampled[sampled > 0.1 * diameter],
            abs=0.1 * diameter,
        )
        nearest = tuple(np.clip(np.round(place[0]).astype(int), 0, 11))
        assert found[nearest] == found.max() == pytest.approx(0.5 * diameter)


def test_no_rock_is_lost_and_the_highest_counts():
    rocks = draw_rocks((40, 30), SIDES, 0.15, 5, (0.05, 1.0))
    together = rock_heights((40, 30), SIDES, rocks)
    alone = [
        rock_heights((40, 30), SIDES, Rocks(*(each[at : at + 1] for each in rocks)))
        for at in range(len(rocks[0]))
    ]
    assert len(alone) > 100 and all(each.max() > 0.0 for each in alone)
    assert np.array_equal(np.maximum.reduce(alone), together)


def test_heights_only_rise_what_is_unknown_stays_so_and_the_input_is_untouched():
    dem = hills()
    dem[10:14, 20:25] = np.nan
    before = dem.copy()
    found = with_rocks(dem, 0.25, 0.2, 4)
    known = np.isfinite(before)
    assert np.array_equal(dem, before, equal_nan=True) and np.array_equal(np.isfinite(found), known)
    assert (found[known] >= before[known]).all() and (found[known] > before[known]).any()
    assert found.dtype == np.float32 and (found - before)[known].max() <= 1.5 + 1e-4


def test_the_seed_decides_and_cells_of_two_sides_hold_as_many_by_area():
    dem = hills()
    one = with_rocks(dem, 0.25, 0.1, 7)
    same = with_rocks(dem, 0.25, 0.1, np.random.default_rng(7))
    assert np.array_equal(one, same) and not np.array_equal(one, with_rocks(dem, 0.25, 0.1, 8))
    assert np.array_equal(with_rocks(dem, 0.25, 0.0, 1), dem)
    square, oblong = (
        draw_rocks((400, 400), sides, 0.1, 1, (0.3, 2.0)) for sides in ((0.5, 0.5), (0.25, 1.0))
    )
    assert len(square.diameters_m) == len(oblong.diameters_m) > 1000


BAD = r"""
cover=-0.01 | from 0 to 0.2, got -0.01
cover=0.21 | from 0 to 0.2, got 0.21
cover=math.nan | got nan
cell_size_m=0.0 | cell size
cell_size_m=-1.0 | cell size
cell_size_m=54.0 | got 27 and 3
dem=np.zeros(3) | \(H, W\)
"""


@pytest.mark.parametrize(("change", "words"), cases(BAD))
def test_bad_input_is_one_clear_error(change, words):
    given = {"dem": hills(), "cell_size_m": 0.25, "cover": 0.1, "rng": 1}
    error = InvalidQueryError if "got" in words else InvalidMapError
    with pytest.raises(error, match=words) as caught:
        with_rocks(**given | keywords(change, {"np": np, "math": math}))
    assert "\n" not in str(caught.value)

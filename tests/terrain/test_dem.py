"""Elevation maps from files: what is read, in which units, and what is refused with which words."""

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from rasterio import Affine

from nnpp_edge.runtime.errors import (
    INSTALL,
    InvalidQueryError,
    MissingExtraError,
    OutputError,
    TerrainError,
)
from nnpp_edge.terrain.dem import Dem, Georeference, read_dem
from nnpp_edge.terrain.rasters import raster_bytes
from tests.strategies import uniform
from tests.tables import cases, keywords

NOWHERE = np.full((3, 3), np.nan)
HEIGHTS = uniform(7, (6, 9), -50, 80)
UTM = "EPSG:32615"
MOON_RADIUS_M = 1737400.0
MOON_DEGREES = (
    f'GEOGCS["Moon",DATUM["Moon",SPHEROID["Moon sphere",{MOON_RADIUS_M},0]],PRIMEM["Reference '
    'Meridian",0],'
    'UNIT["degree",0.0174532925199433]]'
)
NORTH_UP = Affine(5, 0, 400_000, 0, -5, 5_000_000)
BEYOND_POLES = Affine(1, 0, 0, 0, -1, 150)


def geotiff(path, heights=HEIGHTS, **profile):
    """A GeoTIFF of `heights` (H, W) or (bands, H, W); `profile` goes to rasterio."""
    bands = heights.reshape((-1, *heights.shape[-2:]))
    said = {name: profile.pop(name) for name in ("scales", "offsets", "units") if name in profile}
    shape = dict(zip(("count", "height", "width"), bands.shape, strict=True))
    profile = {"driver": "GTiff", "dtype": bands.dtype, "transform": NORTH_UP} | shape | profile
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(bands)
        for name, value in said.items():
            setattr(dataset, name, value)
    return path


def turned(angle, width, height):
    """Cells of `width` by `height`, north up, then turned counter-clockwise by `angle` degrees."""
    cos = math.cos(math.radians(angle))
    sin = math.sin(math.radians(angle))
    return Affine(width * cos, height * sin, 4e5, width * sin, -height * cos, 5e6)


def dem_of(heights=HEIGHTS, georeference=None):
    return Dem(heights.astype(np.float32), 5.0, 4.0, georeference, Path("made.tif"))


def refused(path, *words, **options):
    """`path` is refused in one line that names it and holds every one of `words`."""
    with pytest.raises(TerrainError) as caught:
        read_dem(path, **options)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for word in words:
        assert word in message


# Rasters


def test_a_metric_geotiff_keeps_its_heights_and_cells(tmp_path):
    path = geotiff(tmp_path / "hills.tif", crs=UTM)
    dem = read_dem(path)
    np.testing.assert_array_equal(dem.elevation, HEIGHTS)
    assert dem.elevation.dtype == np.float32 and dem.elevation.flags.c_contiguous
    assert dem.cell_size_m == dem.cell_width_m == pytest.approx(5.0, rel=3e-4)  # UTM's own scale
    assert dem.source == path and dem.georeference.transform == tuple(NORTH_UP)[:6]
    assert rasterio.CRS.from_wkt(dem.georeference.crs) == rasterio.CRS.from_string(UTM)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_sides_are_the_files_or_those_that_are_given(tmp_path):
    flat = geotiff(tmp_path / "flat.tif", transform=Affine(0, 1, 400_000, 1e-300, 0, 9))
    refused(flat, "sides of 1e-06 to 1e+09 m", cell_size_m=2)
    for size in (0, math.nan, math.inf):
        refused(geotiff(tmp_path / "a.tif"), "sides of 1e-06 to 1e+09 m", cell_size_m=size)
    dem = read_dem(geotiff(tmp_path / "turned.tif", transform=turned(33.0, 3.0, 2.0)))
    assert (dem.cell_size_m, dem.cell_width_m) == pytest.approx((2.0, 3.0))
    path = geotiff(tmp_path / "wide.tif", transform=Affine(3, 0, 0, 0, -2, 0))
    dem = read_dem(path)
    assert (dem.cell_size_m, dem.cell_width_m, dem.georeference.crs) == (2.0, 3.0, None)
    dem = read_dem(path, cell_size_m=10)
    assert (dem.cell_size_m, dem.cell_width_m) == (10.0, 15.0)
    path = geotiff(tmp_path / "plain.tif", transform=Affine.identity())
    refused(path, "no cell size in the file; give it with --cell-size METRES")
    dem = read_dem(path, cell_size_m=2.5)
    assert (dem.cell_size_m, dem.cell_width_m, dem.georeference) == (2.5, 2.5, None)


def test_feet_become_metres(tmp_path):
    """Of cells in other systems: tests.fuzz.projections."""
    site = rasterio.CRS.from_wkt('LOCAL_CS["site",UNIT["foot",0.3048]]')
    path = geotiff(tmp_path / "site.tif", crs=site)
    assert read_dem(path).cell_size_m == pytest.approx(5 * 0.3048)
    path = tmp_path / "heights.tif"
    for unit in ("ft", "Feet", "international foot", "foot_us", "US survey feet"):
        geotiff(path, crs=UTM, units=[unit])
        np.testing.assert_allclose(read_dem(path).elevation, HEIGHTS * 0.3048, rtol=1e-5)
    geotiff(path, crs=UTM, units=["furlong"])
    refused(path, "wanted heights in m, cm, km, ft or ftUS, got the unit 'furlong'")
    geotiff(path, crs="EPSG:2264")  # in feet
    with pytest.warns(UserWarning, match="in US survey foot, but heights are read as metres"):
        read_dem(path)


def test_nodata_masks_infinities_and_fill_values_become_nan(tmp_path):
    heights = HEIGHTS.copy()
    heights[0, :4] = -9999, np.inf, np.nan, -3.4028227e38
    elevation = read_dem(geotiff(tmp_path / "holes.tif", heights, crs=UTM, nodata=-9999)).elevation
    assert np.isnan(elevation[0, :4]).all()
    np.testing.assert_array_equal(elevation.ravel()[4:], HEIGHTS.ravel()[4:])
    path = geotiff(tmp_path / "masked.tif", crs=UTM)
    known = HEIGHTS > 0
    with rasterio.open(path, "r+") as dataset:
        dataset.write_mask(known)
    np.testing.assert_array_equal(np.isfinite(read_dem(path).elevation), known)


def test_scale_and_offset_of_the_band_are_applied_but_not_to_nodata_nor_a_bodys_radius(tmp_path):
    stored = np.array([[0, 100], [-32768, 300]], np.int16)
    scale = {"scales": [0.1], "offsets": [1000.0]}
    path = geotiff(tmp_path / "dm.tif", stored, crs=UTM, nodata=-32768, **scale)
    np.testing.assert_allclose(read_dem(path).elevation, [[1000, 1010], [np.nan, 1030]], rtol=1e-6)
    fine = np.array([[0.0, 0.001], [0.002, 0.003]], np.float32)
    path = geotiff(tmp_path / "radius.tif", fine, crs=UTM, scales=[1.0], offsets=[MOON_RADIUS_M])
    np.testing.assert_array_equal(read_dem(path).elevation, fine)


@pytest.mark.parametrize(
    ("heights", "words", "profile"),
    [
        (np.zeros((3, 4, 4), np.uint8), "wanted one band of elevation, got 3 bands", {}),
        (HEIGHTS.astype(np.complex64), "complex64", {}),
        (np.full((3, 3), -1, np.int16), "no cell with a known", {"nodata": -1}),
        (HEIGHTS, "turned back", {"transform": Affine(1, 2, 0, 2, 4, 0)}),
        (HEIGHTS, "the poles, got 147°", {"crs": "EPSG:4326", "transform": BEYOND_POLES}),
    ],
)
def test_what_is_no_map_of_heights_is_refused(tmp_path, heights, words, profile):
    refused(geotiff(tmp_path / "map.tif", heights, **{"crs": UTM} | profile), words)


def test_reading_says_nothing_on_the_side_and_the_refusal_gives_the_first_cause(
    tmp_path,
    capfd,
    recwarn,
):
    read_dem(geotiff(tmp_path / "plain.tif", transform=Affine.identity()), cell_size_m=1)
    recwarn.clear()
    read_dem(tmp_path / "plain.tif", cell_size_m=1)
    (tmp_path / "broken.tif").write_bytes(b"II*\x00" + b"\xff" * 60)
    refused(tmp_path / "broken.tif")
    path = geotiff(tmp_path / "x.tif", np.zeros((300, 300), np.float32), crs=UTM)
    path.write_bytes(path.read_bytes()[:200_000])
    with pytest.raises(TerrainError, match=r"x.tif: .*([Ss]trip|Cannot read)") as caught:
        read_dem(path)
    assert "See previous exception" not in str(caught.value)
    assert capfd.readouterr() == ("", "") and len(recwarn) == 0


# Other formats

ASCII = (
    "ncols 3\nnrows 2\nxllcorner 100\nyllcorner 50\ncellsize 5\nNODATA_value -9999\n"
    "nan 2 -9999\n4 5 6\n"
)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_an_ascii_grid_is_read(tmp_path, end):
    path = tmp_path / "grid.asc"
    path.write_text(ASCII, newline=end)
    dem = read_dem(path)
    wanted = np.array([[np.nan, 2, np.nan], [4, 5, 6]], np.float32)
    np.testing.assert_array_equal(dem.elevation, wanted)
    assert (dem.cell_size_m, dem.cell_width_m) == (5.0, 5.0)
    assert dem.map_coordinates(1, 0) == (102.5, 52.5)


DAMAGE = """
5 6           | 5             | wanted 6 heights
5 6           | 5 six         | cannot be read
xllcorner 100 | xllcorner inf | finite coordinates
cellsize 5    | cellsize 1e100 | sides of 1e-06 to
"""


@pytest.mark.parametrize(("old", "new", "word"), cases(DAMAGE, 3))
def test_an_ascii_grid_that_is_damaged_is_refused_and_not_filled_with_zeros(
    tmp_path,
    old,
    new,
    word,
):
    (tmp_path / "grid.asc").write_text(ASCII.replace(old, new))
    refused(tmp_path / "grid.asc", word)


def pds3_label(record_bytes, pointer, sample, image, scale):
    """A PDS3 label of a map 4 samples wide and 64 lines high, in the manner of the lunar
    altimeters'.
    """
    sample_type, bits = sample.split()
    lines = f"""PDS_VERSION_ID = PDS3
        RECORD_TYPE = FIXED_LENGTH
        RECORD_BYTES = {record_bytes}
        ^IMAGE = {pointer}
        OBJECT = IMAGE
          LINES = 64
          LINE_SAMPLES = 4
          SAMPLE_TYPE = {sample_type}
          SAMPLE_BITS = {bits}
          {image}
        END_OBJECT = IMAGE
        OBJECT = IMAGE_MAP_PROJECTION
          MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"
          A_AXIS_RADIUS = 1737.4 <KM>
          B_AXIS_RADIUS = 1737.4 <KM>
          C_AXIS_RADIUS = 1737.4 <KM>
          CENTER_LATITUDE = 0.0 <DEG>
          CENTER_LONGITUDE = 0.0 <DEG>
          MAP_SCALE = {scale}
          LINE_PROJECTION_OFFSET = 0.5
          SAMPLE_PROJECTION_OFFSET = 0.5
        END_OBJECT = IMAGE_MAP_PROJECTION
        END
        """
    return "\r\n".join(line.strip() for line in lines.splitlines()).encode()


def test_a_pds3_image_with_its_label_attached_is_read(tmp_path):
    heights = np.random.default_rng(1).uniform(-2, 2, (64, 4)).astype("<f4")
    label = pds3_label(2048, "2", "PC_REAL 32", "MISSING_CONSTANT = 7.0", "20 <M/PIXEL>")
    stored = heights.copy()
    stored[0, 0] = 7.0
    (tmp_path / "dtm.img").write_bytes(label.ljust(2048) + stored.tobytes())
    dem = read_dem(tmp_path / "dtm.img")
    assert np.isnan(dem.elevation[0, 0])
    np.testing.assert_array_equal(dem.elevation.ravel()[1:], heights.ravel()[1:])
    assert (dem.cell_size_m, dem.cell_width_m) == (20.0, 20.0)


@pytest.fixture
def detached(tmp_path):
    """A PDS3 image, its label beside it, and its heights: half metres above a sphere."""
    stored = np.random.default_rng(2).integers(-999, 999, (64, 4)).astype("<i2")
    scaling = "OFFSET = 1737400\nSCALING_FACTOR = 0.5\nUNIT = METER"
    label = pds3_label(8, '("LDEM.IMG", 1)', "LSB_INTEGER 16", scaling, "0.118 <KM/PIXEL>")
    (tmp_path / "ldem.lbl").write_bytes(label)
    (tmp_path / "ldem.img").write_bytes(stored.tobytes())
    return tmp_path / "ldem.img", tmp_path / "ldem.lbl", stored * 0.5


def test_a_pds3_image_is_read_through_the_label_beside_it(detached):
    image, label, heights = detached
    for path in (image, label):
        dem = read_dem(path)
        np.testing.assert_array_equal(dem.elevation, heights)
        assert dem.cell_size_m == pytest.approx(118) and dem.source == path
    label.write_bytes(
        label.read_bytes().replace(b"METER", b"KILOMETER").replace(b"1737400", b"1737.4")
    )
    np.testing.assert_allclose(read_dem(label).elevation, heights * 1000, rtol=1e-6)


def test_a_pds3_image_cut_short_is_refused_and_not_filled_with_zeros(detached):
    image, label, _ = detached
    heights = np.tile(np.fromfile(image, "<i2"), 64)  # much larger than the label
    label.write_bytes(label.read_bytes().replace(b"LINES = 64", b"LINES = 4096"))
    image.write_bytes(heights.tobytes())
    assert read_dem(image).elevation.shape == (4096, 4)
    image.write_bytes(heights.tobytes()[: heights.nbytes // 2])
    refused(image, "wanted 32768 bytes of heights")


@pytest.mark.parametrize("dtype", [np.float64, np.int16, ">f4", np.float16])
def test_an_array_file_is_read_with_the_cell_size_given(tmp_path, dtype):
    path = tmp_path / "map.npy"
    heights = np.asfortranarray(HEIGHTS.astype(dtype))
    np.save(path, heights)
    refused(path, "--cell-size")
    dem = read_dem(path, cell_size_m=0.5)
    np.testing.assert_array_equal(dem.elevation, heights.astype(np.float32))
    assert dem.elevation.dtype == np.float32 and dem.elevation.flags.c_contiguous
    assert (dem.cell_size_m, dem.georeference) == (0.5, None)


@pytest.mark.parametrize(
    "array",
    [HEIGHTS[0], HEIGHTS[:0], HEIGHTS.astype(complex), HEIGHTS > 0, HEIGHTS.astype(str), NOWHERE],
)
def test_an_array_that_is_no_elevation_map_is_refused(tmp_path, array):
    np.save(tmp_path / "map.npy", array)
    refused(tmp_path / "map.npy", cell_size_m=1)


@pytest.mark.parametrize("size", ["cell_size_m", "cell_m"])
@pytest.mark.parametrize("name", ["elevation_m", "elevation", "dem", "anything"])
def test_an_archive_holds_heights_and_cell_size_under_several_names(tmp_path, name, size):
    np.savez(tmp_path / "map.npz", **{name: HEIGHTS, size: 3.0, "note": np.arange(3)})
    dem = read_dem(tmp_path / "map.npz")
    np.testing.assert_array_equal(dem.elevation, HEIGHTS)
    assert (dem.cell_size_m, dem.cell_width_m) == (3.0, 3.0)


def test_an_archive_may_hold_other_maps_and_the_width_of_cells(tmp_path):
    path = tmp_path / "map.npz"
    np.savez(path, dem=HEIGHTS, other=HEIGHTS * 2, cell_size_m=4, cell_width_m=[2.0])
    dem = read_dem(path)
    np.testing.assert_array_equal(dem.elevation, HEIGHTS)
    assert (dem.cell_size_m, dem.cell_width_m) == (4.0, 2.0)
    assert read_dem(path, cell_size_m=10).cell_width_m == 5.0


NO_ELEVATIONS = """
dem=None, a=HEIGHTS, b=HEIGHTS | got a, b
dem=None | got nothing
dem=HEIGHTS[None] | (1, 6, 9)
cell_width_m=2.0 | cell_size_m beside
dem=np.array([[{}]]) | object
cell_m=np.nan | cell_m must be one number above 0
cell_m='5 m' | cell_m must be one number above 0
transform=np.zeros(6) | transform must place cells apart
transform=np.arange(5.0) | transform must be 6 numbers (a, b, c, d, e, f)
transform=[1, 2, 3, 4, 5, np.nan] | transform must be 6 numbers (a, b, c, d, e, f)
transform=['a'] * 6 | transform must be 6 numbers (a, b, c, d, e, f)
"""


@pytest.mark.parametrize(
    ("arrays", "word"),
    cases(NO_ELEVATIONS),
)
def test_an_archive_that_is_no_elevation_map_is_refused(tmp_path, arrays, word):
    given = {"dem": HEIGHTS} | keywords(arrays, globals())
    np.savez(
        tmp_path / "map.npz",
        **{name: each for name, each in given.items() if each is not None},
    )
    refused(tmp_path / "map.npz", word)


# Files that are no terrain at all


@pytest.mark.parametrize("content", [b"", b"Dear reader,\nno terrain.\n", b"\x00\xff" * 300])
@pytest.mark.parametrize("name", ["x.tif", "x.asc", "x.img", "x.lbl", "x.npy", "x.npz", "x"])
def test_what_is_no_terrain_is_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name, "wanted", cell_size_m=1)


def test_what_is_no_file_or_a_recording_is_refused(tmp_path):
    refused(tmp_path / "none.tif", "(no such file)")
    refused(tmp_path, "(a folder)")
    (tmp_path / "drive.mcap").write_bytes(b"\x89MCAP0\r\n")
    refused(tmp_path / "drive.mcap", "got a recording of messages", "nnpp_edge.ros.maps")


def test_without_rasterio_the_extra_is_named_and_arrays_still_read(tmp_path, monkeypatch):
    path = geotiff(tmp_path / "hills.tif", crs=UTM)
    np.save(tmp_path / "map.npy", HEIGHTS)
    monkeypatch.setitem(sys.modules, "rasterio", None)
    wanted = re.escape(f"reading hills.tif needs rasterio: {INSTALL.format('geo')}")
    with pytest.raises(MissingExtraError, match=wanted):
        read_dem(path)
    dem = read_dem(tmp_path / "map.npy", cell_size_m=1)
    with pytest.raises(MissingExtraError, match=r"writing out.tif needs rasterio"):
        raster_bytes(tmp_path / "out.tif", HEIGHTS, dem)
    (tmp_path / "drive.mcap").write_bytes(b"\x89MCAP0\r\n")
    refused(tmp_path / "drive.mcap", "got a recording of messages")


# The map itself


@given(st.floats(1e-3, 1e3))
def test_rescaling_keeps_every_slope(cell_size_m):
    dem = dem_of(georeference=Georeference(None, tuple(NORTH_UP)[:6]))
    grown = dem.rescaled(cell_size_m)
    assert grown.cell_size_m == cell_size_m and grown.elevation.dtype == np.float32
    assert grown.georeference is None, "its metres are its own"
    slopes, grown_slopes = (
        np.gradient(each.elevation.astype(float), each.cell_size_m, each.cell_width_m)
        for each in (dem, grown)
    )
    np.testing.assert_allclose(grown_slopes, slopes, atol=1e-5)
    np.testing.assert_array_equal(dem.elevation, HEIGHTS)


@given(
    st.integers(-50, 5000),
    st.integers(-50, 5000),
    st.floats(0, 360),
    st.tuples(st.floats(0.1, 100), st.floats(0.1, 100)),
    st.floats(-0.49, 0.49),
)
def test_every_point_of_a_cell_belongs_to_it(row, col, angle, sides, inset):
    transform = turned(angle, *sides)
    dem = dem_of(georeference=Georeference(None, tuple(transform)[:6]))
    x, y, _ = np.reshape(transform, (3, 3)) @ (col + 0.5, row + 0.5, 1)
    assert dem.map_coordinates(row, col) == pytest.approx((x, y))
    assert dem.cell_of(*dem.map_coordinates(row + inset, col - inset)) == (row, col)


def test_map_coordinates_are_finite_and_without_a_georeference_metres_from_the_first_cell():
    dem = dem_of()
    assert dem.map_coordinates(5, 4) == (16.0, 25.0) and dem.cell_of(17.9, 27.4) == (5, 4)
    with pytest.raises(InvalidQueryError, match=r"must be finite"):
        dem_of(georeference=Georeference(None, (1, 0, 0, 0, -1, 0))).cell_of(math.nan, 0)


@pytest.mark.parametrize(
    ("elevation", "size", "width"),
    [
        (HEIGHTS.astype(float), 1.0, 1.0),
        (HEIGHTS[0], 1.0, 1.0),
        (NOWHERE.astype(np.float32), 1.0, 1.0),
        (HEIGHTS, 0.0, 1.0),
        (HEIGHTS, 1.0, math.inf),
    ],
)
def test_a_map_that_breaks_its_own_terms_cannot_be_made(elevation, size, width):
    with pytest.raises(TerrainError, match=r"^made.tif: "):
        Dem(elevation, size, width, None, Path("made.tif"))


def test_masked_cells_are_unknown_in_a_map_and_in_a_file(tmp_path):
    """As rasterio's `read(masked=True)` gives them; what lies under the mask is anything."""
    wanted = np.where(HEIGHTS > 0, HEIGHTS, np.nan)
    masked = np.ma.array(HEIGHTS, mask=HEIGHTS <= 0)
    dem = Dem(masked, 5.0, 4.0, None, Path("made.tif"))
    assert type(dem.elevation) is np.ndarray
    np.testing.assert_array_equal(dem.elevation, wanted)
    (tmp_path / "heights.tif").write_bytes(raster_bytes(Path("heights.tif"), masked, dem))
    back = read_dem(tmp_path / "heights.tif", cell_size_m=1).elevation
    np.testing.assert_array_equal(back, wanted)


# Writing


def test_what_is_written_reads_back_in_its_place(tmp_path, recwarn):
    cost = np.where(HEIGHTS > 0, HEIGHTS, np.nan)
    for crs in (UTM, MOON_DEGREES, "EPSG:2263", None):
        dem = read_dem(
            geotiff(tmp_path / "hills.tif", crs=crs, transform=Affine(0.5, 0, 10, 0, -0.25, 20))
        )
        (tmp_path / "cost.tif").write_bytes(raster_bytes(Path("cost.tif"), cost, dem))
        back = read_dem(tmp_path / "cost.tif")
        np.testing.assert_array_equal(back.elevation, cost)
        assert back.georeference == dem.georeference
        assert (back.cell_size_m, back.cell_width_m) == (dem.cell_size_m, dem.cell_width_m)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cost.tif", "hills.tif"]
    for array in (np.where(HEIGHTS > 0, np.inf, 1.0), HEIGHTS > 0):
        content = raster_bytes(Path("cost.tif"), array, dem_of(georeference=dem.georeference))
        with rasterio.MemoryFile(content) as file, file.open() as dataset:
            np.testing.assert_array_equal(dataset.read(1), array.astype(np.float32))


def test_what_cannot_be_written_is_one_error():
    unknown = dem_of(georeference=Georeference("no such system", (1, 0, 0, 0, -1, 0)))
    with pytest.raises(OutputError, match=r"out.tif: could not be written"):
        raster_bytes(Path("out.tif"), HEIGHTS, unknown)

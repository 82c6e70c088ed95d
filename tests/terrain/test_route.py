"""Places on the globe, and paths and areas as vector files."""

import json
from pathlib import Path

import numpy as np
import pyogrio
import pytest
from pyproj import CRS
from rasterio import Affine
from rasterio.features import rasterize

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.terrain.coordinates import lonlat_at, lonlat_on_map
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.georeference import Georeference
from nnpp_edge.terrain.route import Reach, Route
from tests.strategies import uniform

UTM = "EPSG:32615"
PLACE = Georeference(CRS(UTM).to_wkt(), (2.0, 0.0, 400_000.0, 0.0, -2.0, 5_000_000.0))
MOON = (
    'PROJCS["Moon",GEOGCS["Moon '
    '2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000",1737400,0]],PRIMEM["Reference",0],'
    'UNIT["degree",0.0174532925199433]],'
    'PROJECTION["Equirectangular"],PARAMETER["standard_parallel_1",0],'
    'PARAMETER["central_meridian",0],UNIT["metre",1]]'
)


def dem(place=PLACE, shape=(80, 90)):
    return Dem(np.zeros(shape, np.float32), 2.0, 2.0, place, Path("dem.tif"))


def test_longitude_and_latitude_are_wgs_84_on_the_earth_and_the_bodys_own_elsewhere():
    there = np.array([(400_010.5, 4_999_989.5)])
    assert lonlat_on_map(dem(), lonlat_at(dem(), there)) == pytest.approx(there, abs=1e-6)
    moon = dem(Georeference(MOON, (2.0, 0.0, 0.0, 0.0, -2.0, 0.0)))
    metre = np.pi / 180.0 * 1_737_400.0
    assert lonlat_on_map(moon, np.array([(1.0, -2.0)])) == pytest.approx(
        np.array([(metre, -2.0 * metre)])
    )


def test_places_of_another_world_or_of_none_are_refused():
    for place in (None, Georeference(None, PLACE.transform)):
        with pytest.raises(InvalidQueryError, match="wanted a map with a coordinate system"):
            lonlat_on_map(dem(place), np.array([(1.0, 2.0)]))
    with pytest.raises(InvalidQueryError, match="longitude 10, latitude 95 of WGS 84 has no place"):
        lonlat_on_map(dem(), np.array([(10.0, 95.0)]))


def route(place=PLACE, cells=((3, 4), (4, 5), (4, 6))):
    ground = dem(place)
    path = np.array(cells, np.int32).reshape(-1, 2)
    along = Along.of(path, ground.elevation + np.arange(90.0), (2.0, 2.0))
    return Route.of(path, along, np.full((80, 90), 0.5, np.float32), ground)


def test_a_geopackage_holds_the_line_with_its_heights_and_the_numbers(tmp_path):
    (tmp_path / "a.gpkg").write_bytes(
        route().geopackage({"status": "OK", "cost": 1.5, "energy_j": None})
    )
    meta, _, (shape,), (status, cost, _) = pyogrio.raw.read(tmp_path / "a.gpkg")
    assert (meta["geometry_type"], meta["crs"]) == ("LineString Z", UTM)
    assert (status.tolist(), cost.tolist()) == (["OK"], [1.5])
    points = np.frombuffer(shape[9:], "<f8").reshape(-1, 3)
    assert (points - (400_009, 4_999_991, 4)).tolist() == [[0, 2, 0], [2, 0, 1], [4, 0, 2]]


def test_no_path_is_a_geopackage_without_a_line(tmp_path):
    empty = route(cells=())
    (tmp_path / "a.gpkg").write_bytes(empty.geopackage({"status": "NO_PATH", "cost": None}))
    assert pyogrio.raw.read(tmp_path / "a.gpkg")[2].tolist() == [None]


def crs_of_geojson(place, folder):
    (folder / "path.geojson").write_bytes(route(place).geojson({}))
    return pyogrio.read_info(folder / "path.geojson")["crs"]


@pytest.mark.parametrize("crs", [UTM, MOON, "IAU_2015:49910"])
def test_geojson_lies_where_the_map_does(tmp_path, crs):
    found = crs_of_geojson(Georeference(CRS(crs).to_wkt(), PLACE.transform), tmp_path)
    assert CRS(found).equals(CRS(crs), ignore_axis_order=True)


def test_geojson_of_a_map_without_a_system_does_not_lie_on_the_earth(tmp_path):
    assert crs_of_geojson(None, tmp_path).startswith("LOCAL_CS")


@pytest.mark.parametrize("place", [PLACE, None])
def test_areas_are_the_cells_that_are_reached_with_their_holes(place):
    field = uniform(1, (80, 90), 0.0, 4.0)
    field[field > 3.0] = np.inf
    found = Reach(field, (1.0, 2.0, 3.0), "time", "s", dem(place))
    transform = Affine(*found.dem.located.transform)
    for level, cells, square_m in map(dict.values, found.areas):
        assert square_m == 4.0 * cells == 4.0 * (field <= level).sum()
        polygons = [{"type": "Polygon", "coordinates": each} for each in found.polygons(level)]
        drawn = rasterize(polygons, field.shape, transform=transform)
        np.testing.assert_array_equal(drawn > 0, field <= level)
    collection = json.loads(found.geojson())
    assert [each["properties"]["within"] for each in collection["features"]] == [3.0, 2.0, 1.0]
    assert "crs" in collection
    assert np.isnan(found.raster()[np.isinf(field)]).all()

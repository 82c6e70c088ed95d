"""Points of GeoJSON on a map, and paths and areas as vector files."""

import json
import struct
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyogrio
import pytest
from pyproj import CRS, Transformer

from nnpp_edge.runtime.errors import InvalidQueryError, MissingExtraError
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.terrain.coordinates import lonlat_of, lonlat_on_map
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.georeference import Georeference
from nnpp_edge.terrain.route import Reach, Route, places_of
from nnpp_edge.terrain.vectors import VectorFileError, points_of

UTM = "EPSG:32615"
PLACE = Georeference(CRS(UTM).to_wkt(), (2.0, 0.0, 400_000.0, 0.0, -2.0, 5_000_000.0))
MOON = (
    'PROJCS["Moon",GEOGCS["Moon 2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000",1737400,0]],PRIMEM["Reference",0],'
    'UNIT["degree",0.0174532925199433]],PROJECTION["Equirectangular"],PARAMETER["standard_parallel_1",0],'
    'PARAMETER["central_meridian",0],UNIT["metre",1]]'
)
PLACES = [(400_010.5, 4_999_989.5), (400_100.0, 4_999_900.0), (400_050.0, 4_999_950.0)]


def dem(place=PLACE, shape=(80, 90)):
    return Dem(np.zeros(shape, np.float32), 2.0, 2.0, place, Path("dem.tif"))


def write(path, shape, crs=UTM):
    content = shape if crs is None else {**shape, "crs": {"type": "name", "properties": {"name": crs}}}
    path.write_text(json.dumps(content))
    return path


def points(places, kind="MultiPoint"):
    return {"type": kind, "coordinates": places}


def test_points_in_the_maps_system_are_taken_as_they_are_in_their_order(tmp_path):
    shapes = [points((*place, 7.0), "Point") for place in PLACES]
    features = [{"type": "Feature", "geometry": shape, "properties": {}} for shape in (shapes[0], None, *shapes[1:])]
    for shape in (
        points(PLACES),
        {"type": "FeatureCollection", "features": features},
        {"type": "GeometryCollection", "geometries": shapes},
    ):
        found, word = points_of(write(tmp_path / "a.geojson", shape), dem())
        assert list(map(tuple, found.tolist())) == PLACES and word == ""


def test_points_in_another_system_or_in_none_are_reprojected_and_it_is_said(tmp_path):
    lonlat = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True)
    there = points([lonlat.transform(*place) for place in PLACES])
    for crs in ("EPSG:4326", "urn:ogc:def:crs:OGC:1.3:CRS84", None):
        found, word = points_of(path := write(tmp_path / "a.geojson", there, crs), dem())
        assert found == pytest.approx(np.array(PLACES), abs=1e-3)
        assert word.startswith(f"{path}: reprojected from WGS 84") and word.endswith("to WGS 84 / UTM zone 15N")


def test_what_is_no_file_of_points_is_refused_in_one_line(tmp_path):
    for content, words in (
        (b'{"type": "Feature", ', "wanted GeoJSON"),
        (b"SQLite format 3\0", "ogr2ogr makes it of other layers"),
        (b"3", "got int"),
        (b'{"type": "Feature", "geometry": null, "properties": {}}', "wanted points, got none"),
        (b'{"type": "MultiPoint", "coordinates": []}', "wanted points, got none"),
        (b'{"type": "LineString", "coordinates": [[0, 0], [1, 1]]}', "got LineString"),
        (b'{"type": "Point", "coordinates": ["a", 1]}', "wanted GeoJSON"),
        (b'{"type": "Point", "coordinates": [1, 2], "crs": {"properties": {"name": "nowhere"}}}', "nowhere"),
        (b'{"type": "Point", "coordinates": [1, 2], "crs": 3}', "wanted GeoJSON"),
        (b'{"a":' * 90_000, "nested too deep"),
    ):
        (tmp_path / "a.geojson").write_bytes(content)
        with pytest.raises(VectorFileError, match=words) as caught:
            points_of(tmp_path / "a.geojson", dem())
        assert "\n" not in str(caught.value) and "a.geojson" in str(caught.value)


def test_longitude_and_latitude_are_wgs_84_on_the_earth_and_the_bodys_own_elsewhere():
    there = np.array([PLACES[0]])
    assert lonlat_on_map(dem(), lonlat_of(dem(), there)) == pytest.approx(there, abs=1e-6)
    moon = dem(Georeference(MOON, (2.0, 0.0, 0.0, 0.0, -2.0, 0.0)))
    metre = np.pi / 180.0 * 1_737_400.0
    assert lonlat_on_map(moon, np.array([(1.0, -2.0)])) == pytest.approx(np.array([(metre, -2.0 * metre)]))
    with pytest.raises(InvalidQueryError, match="longitude and latitude on the Earth"):
        lonlat_of(moon, there)


def test_places_and_layers_of_another_world_or_of_none_are_refused(tmp_path):
    for place in (None, Georeference(None, PLACE.transform)):
        with pytest.raises(InvalidQueryError, match="wanted a map with a coordinate system"):
            lonlat_on_map(dem(place), np.array([(1.0, 2.0)]))
    with pytest.raises(InvalidQueryError, match="longitude 10, latitude 95 of WGS 84 has no place"):
        lonlat_on_map(dem(), np.array([(10.0, 95.0)]))
    path = write(tmp_path / "a.geojson", points([(1.0, 2.0)]), MOON)
    with pytest.raises(InvalidQueryError, match="two bodies"):
        points_of(path, dem())


def test_where_pyproj_is_missing_it_is_said_which_extra_brings_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(MissingExtraError, match=r"needs pyproj.*nnpp-edge\[geo\]"):
        points_of(write(tmp_path / "a.geojson", points([(1.0, 2.0)])), dem())


def route(place=PLACE, cells=((3, 4), (4, 5), (4, 6))):
    ground = dem(place)
    path = np.array(cells, np.int32).reshape(-1, 2)
    along = Along.of(path, ground.elevation + np.arange(90.0), (2.0, 2.0))
    return Route.of(path, along, np.full((80, 90), 0.5, np.float32), ground)


def test_no_path_is_a_gpx_without_points():
    tree = ElementTree.fromstring(route(cells=()).gpx("a way", {"start": (3, 4)}))
    assert [each.tag.rpartition("}")[2] for each in tree] == ["wpt", "trk"]


def test_gpx_holds_the_track_where_the_map_lies_on_the_earth(tmp_path):
    (tmp_path / "a.gpx").write_bytes(route().gpx("a <way>", {"start": (3, 4), "goal": (4, 6)}))
    _, _, shapes, (heights,) = pyogrio.raw.read(tmp_path / "a.gpx", layer="track_points", columns=["ele"])
    x, y = struct.unpack("<dd", shapes[0][5:21])
    lon, lat = lonlat_of(dem(), places_of(dem(), np.array([(3.0, 4.0)])))[0]
    assert (x, y) == (pytest.approx(lon, abs=1e-8), pytest.approx(lat, abs=1e-8))
    names = pyogrio.raw.read(tmp_path / "a.gpx", layer="waypoints", columns=["name"])[3][0].tolist()
    assert names == ["start", "goal"] and heights.tolist() == [4.0, 5.0, 6.0]
    with pytest.raises(InvalidQueryError, match="on the Earth"):
        route(Georeference(MOON, PLACE.transform)).gpx("a way", {})


def test_geojson_lies_where_the_map_does_and_not_on_the_earth(tmp_path):
    for crs in (UTM, MOON, "IAU_2015:49910", None):
        place = None if crs is None else Georeference(CRS(crs).to_wkt(), PLACE.transform)
        (tmp_path / "path.geojson").write_bytes(route(place).geojson({}))
        found = pyogrio.read_info(tmp_path / "path.geojson")["crs"]
        own = found.startswith("LOCAL_CS") if crs is None else CRS(found).equals(CRS(crs), ignore_axis_order=True)
        assert own


def area(polygons):
    """By the shoelace formula; holes turn the other way."""
    total = 0.0
    for polygon in polygons:
        for ring in polygon:
            x, y = np.array(ring).T
            total += 0.5 * float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())
    return abs(total)


@pytest.mark.parametrize("place", [PLACE, None])
def test_areas_are_the_cells_that_are_reached_with_their_holes(place):
    field = np.random.default_rng(1).uniform(0.0, 4.0, (80, 90)).astype(np.float32)
    field[field > 3.0] = np.inf
    found = Reach(field, (1.0, 2.0, 3.0), "time", "s", dem(place))
    for level, square_m in zip(found.levels, found.areas_m2, strict=True):
        assert square_m == 4.0 * (field <= level).sum()
        assert area(found.polygons(level)) == pytest.approx(square_m)
    collection = json.loads(found.geojson())
    assert [each["properties"]["within"] for each in collection["features"]] == [3.0, 2.0, 1.0]
    assert "crs" in collection
    x, y = np.concatenate([np.array(ring) for polygon in found.polygons(3.0) for ring in polygon]).T
    low = (400_000.0, 4_999_840.0) if place else (-1.0, -1.0)
    assert (x.min(), y.min()) == low
    assert np.isnan(found.raster()[np.isinf(field)]).all()

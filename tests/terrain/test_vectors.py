"""Points of vector layers on a map, and paths and areas as vector files."""

import json
import struct
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyogrio
import pytest
from pyproj import CRS, Transformer

from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.along import Along
from nnpp_edge.terrain.coordinates import lonlat_of, lonlat_on_map
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.georeference import Georeference
from nnpp_edge.terrain.route import Reach, Route, places_of
from nnpp_edge.terrain.vectors import VectorFileError, geopackage_bytes, points_of
from tests.strategies import uniform
from tests.tables import cases

UTM = "EPSG:32615"
PLACE = Georeference(CRS(UTM).to_wkt(), (2.0, 0.0, 400_000.0, 0.0, -2.0, 5_000_000.0))
MOON = (
    'PROJCS["Moon",GEOGCS["Moon '
    '2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000",1737400,0]],PRIMEM["Reference",0],'
    'UNIT["degree",0.0174532925199433]],'
    'PROJECTION["Equirectangular"],PARAMETER["standard_parallel_1",0],'
    'PARAMETER["central_meridian",0],UNIT["metre",1]]'
)
PLACES = [(400_010.5, 4_999_989.5), (400_100.0, 4_999_900.0), (400_050.0, 4_999_950.0)]


def dem(place=PLACE, shape=(80, 90)):
    return Dem(np.zeros(shape, np.float32), 2.0, 2.0, place, Path("dem.tif"))


def content(kind, places, crs=UTM):
    named = {"crs": {"type": "name", "properties": {"name": crs}}} if crs else {}
    return json.dumps({"type": kind, "coordinates": places} | named).encode()


def write(path, places, crs=UTM, kind="MultiPoint"):
    made = content(kind, places, crs)
    path.write_bytes(made if path.suffix == ".geojson" else geopackage_bytes("stops", made))
    return str(path)


def write_points(path, places, crs=UTM, layer="stops", driver="GPKG"):
    """A point a feature with its number as its label, the second empty."""
    places = [places[0], (np.nan, np.nan), *places[1:]]
    shapes = [struct.pack("<BIdd", 1, 1, *place) for place in places]
    pyogrio.raw.write(
        path,
        np.array(shapes, object),
        field_data=[np.arange(len(shapes))],
        fields=np.array(["label"], object),
        geometry_type="Point",
        crs=crs,
        layer=layer,
        driver=driver,
        append=path.exists(),
        SPATIAL_INDEX="NO",
    )
    return str(path)


def test_points_in_the_maps_system_are_taken_as_they_are_in_their_order(tmp_path):
    high = [(*place, 7.0) for place in PLACES]
    several = [write(tmp_path / f"several.{ending}", high) for ending in ("geojson", "gpkg")]
    single = write_points(tmp_path / "a.gpkg", PLACES)
    with pytest.warns(UserWarning, match="crs"):
        bare = write_points(tmp_path / "b.shp", PLACES, crs=None, driver="ESRI Shapefile")
    packed = write_points(tmp_path / "a.fgb", PLACES, driver="FlatGeobuf")
    for path in (*several, single, bare, packed):
        found, word = points_of(path, dem())
        assert list(map(tuple, found.tolist())) == PLACES and word == ""


def test_points_in_another_system_are_reprojected_and_it_is_said(tmp_path):
    lonlat = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True)
    there = [lonlat.transform(*place) for place in PLACES]
    points = "".join(f'<wpt lat="{lat:.9f}" lon="{lon:.9f}"/>' for lon, lat in there)
    (tmp_path / "a.gpx").write_text(
        '<?xml version="1.0"?>\n<gpx version="1.1" '
        f'xmlns="http://www.topografix.com/GPX/1/1">{points}</gpx>'
    )
    for path in (
        write(tmp_path / "a.gpkg", there, "EPSG:4326"),
        write(tmp_path / "a.geojson", there, None),
        str(tmp_path / "a.gpx"),
    ):
        found, word = points_of(path, dem())
        assert found == pytest.approx(np.array(PLACES), abs=1e-3)
        assert word == f"{path}: reprojected from WGS 84 to WGS 84 / UTM zone 15N"


def test_of_several_layers_one_is_named(tmp_path):
    path = tmp_path / "a.gpkg"
    write_points(path, PLACES[:1])
    write_points(path, PLACES, layer="more")
    with pytest.raises(VectorFileError, match=r"name it as a.gpkg:LAYER \(stops, more\)"):
        points_of(str(path), dem())
    for layer, count in (("stops", 1), ("more", 3)):
        assert len(points_of(f"{path}:{layer}", dem())[0]) == count
    with pytest.raises(VectorFileError, match="nothing"):
        points_of(f"{path}:nothing", dem())


REFUSED = """
a.vrt     | <OGRVRTDataSource><OGRVRTLayer name='a'/></OGRVRTDataSource><!-- <gpx --> | another kind
a.gpx     | <!-- <gpx --><OGRVRTDataSource/> | another kind of file
a.json    | {"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline"} | another kind
a.geojson | {"type": "Feature",  | wanted GeoPackage, GeoJSON
a.geojson | {"type": "Feature", "geometry": null, "properties": {}} | wanted points, got none
a.geojson | {"type": "MultiPoint", "coordinates": []} | wanted points, got none
a.csv     | x,y\\n1,2 | another kind of file
a.gpkg    | SQLite format 3\\0 | FlatGeobuf with points
a.gpx     | <gpx><wpt | FlatGeobuf with points
a.gpkg    |   | another kind of file
"""


@pytest.mark.parametrize(("name", "made", "words"), cases(REFUSED, 3))
def test_what_is_no_plain_file_of_points_is_refused_in_one_line(tmp_path, name, made, words):
    (tmp_path / name).write_text(made.replace("\\0", "\0" * 100))
    with pytest.raises(VectorFileError, match=words) as caught:
        points_of(str(tmp_path / name), dem())
    assert "\n" not in str(caught.value) and name in str(caught.value)


def test_a_file_that_is_nested_too_deep_or_holds_other_shapes_is_refused(tmp_path):
    (tmp_path / "a.geojson").write_bytes(b'{"a":' * 90_000)
    with pytest.raises(VectorFileError, match="nested too deep"):
        points_of(str(tmp_path / "a.geojson"), dem())
    (tmp_path / "a.gpkg").write_bytes(geopackage_bytes("ways", content("LineString", PLACES)))
    with pytest.raises(VectorFileError, match="other shapes"):
        points_of(str(tmp_path / "a.gpkg"), dem())


@pytest.mark.parametrize("name", ["none.gpkg", "none.gpkg:layer", "."])
def test_a_name_of_no_file_is_refused(tmp_path, name):
    with pytest.raises(VectorFileError, match="wanted a vector file"):
        points_of(str(tmp_path / name), dem())


def test_longitude_and_latitude_are_wgs_84_on_the_earth_and_the_bodys_own_elsewhere():
    there = np.array([PLACES[0]])
    assert lonlat_on_map(dem(), lonlat_of(dem(), there)) == pytest.approx(there, abs=1e-6)
    moon = dem(Georeference(MOON, (2.0, 0.0, 0.0, 0.0, -2.0, 0.0)))
    metre = np.pi / 180.0 * 1_737_400.0
    assert lonlat_on_map(moon, np.array([(1.0, -2.0)])) == pytest.approx(
        np.array([(metre, -2.0 * metre)])
    )
    with pytest.raises(InvalidQueryError, match="longitude and latitude on the Earth"):
        lonlat_of(moon, there)


def test_places_and_layers_of_another_world_or_of_none_are_refused(tmp_path):
    for place in (None, Georeference(None, PLACE.transform)):
        with pytest.raises(InvalidQueryError, match="wanted a map with a coordinate system"):
            lonlat_on_map(dem(place), np.array([(1.0, 2.0)]))
    with pytest.raises(InvalidQueryError, match="longitude 10, latitude 95 of WGS 84 has no place"):
        lonlat_on_map(dem(), np.array([(10.0, 95.0)]))
    path = write_points(tmp_path / "a.gpkg", [(1.0, 2.0)], MOON)
    with pytest.raises(InvalidQueryError, match="two bodies"):
        points_of(path, dem())


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


def test_no_path_is_a_geopackage_without_a_line_and_a_gpx_without_points(tmp_path):
    empty = route(cells=())
    (tmp_path / "a.gpkg").write_bytes(empty.geopackage({"status": "NO_PATH", "cost": None}))
    assert pyogrio.raw.read(tmp_path / "a.gpkg")[2].tolist() == [None]
    tree = ElementTree.fromstring(empty.gpx("a way", [(3, 4), (4, 6)]))
    assert [each.tag.rpartition("}")[2] for each in tree] == ["wpt", "wpt", "trk"]


def test_gpx_holds_the_track_where_the_map_lies_on_the_earth(tmp_path):
    (tmp_path / "a.gpx").write_bytes(route().gpx("a <way>", [(3, 4), (4, 5), (4, 6)]))
    _, _, shapes, (heights,) = pyogrio.raw.read(
        tmp_path / "a.gpx",
        layer="track_points",
        columns=["ele"],
    )
    there = lonlat_of(dem(), places_of(dem(), np.array([(3.0, 4.0)])))[0]
    assert struct.unpack("<dd", shapes[0][5:21]) == pytest.approx(there, abs=1e-8)
    names = pyogrio.raw.read(tmp_path / "a.gpx", layer="waypoints", columns=["name"])[3][0].tolist()
    assert names == ["start", "via 1", "goal"] and heights.tolist() == [4.0, 5.0, 6.0]
    with pytest.raises(InvalidQueryError, match="on the Earth"):
        route(Georeference(MOON, PLACE.transform)).gpx("a way", [(3, 4), (4, 6)])


def crs_of_geojson(place, folder):
    (folder / "path.geojson").write_bytes(route(place).geojson({}))
    return pyogrio.read_info(folder / "path.geojson")["crs"]


@pytest.mark.parametrize("crs", [UTM, MOON, "IAU_2015:49910"])
def test_geojson_lies_where_the_map_does(tmp_path, crs):
    found = crs_of_geojson(Georeference(CRS(crs).to_wkt(), PLACE.transform), tmp_path)
    assert CRS(found).equals(CRS(crs), ignore_axis_order=True)


def test_geojson_of_a_map_without_a_system_does_not_lie_on_the_earth(tmp_path):
    assert crs_of_geojson(None, tmp_path).startswith("LOCAL_CS")


def area(polygons):
    """By the shoelace formula; holes turn the other way."""
    total = 0.0
    for polygon in polygons:
        for ring in polygon:
            x, y = np.array(ring).T
            crossed = x[:-1] * y[1:] - x[1:] * y[:-1]
            total += 0.5 * float(crossed.sum())
    return abs(total)


@pytest.mark.parametrize("place", [PLACE, None])
def test_areas_are_the_cells_that_are_reached_with_their_holes(place):
    field = uniform(1, (80, 90), 0.0, 4.0)
    field[field > 3.0] = np.inf
    found = Reach(field, (1.0, 2.0, 3.0), "time", "s", dem(place))
    for level, cells, square_m in map(dict.values, found.areas):
        assert square_m == 4.0 * cells == 4.0 * (field <= level).sum()
        assert area(found.polygons(level)) == pytest.approx(square_m)
    collection = json.loads(found.geojson())
    assert [each["properties"]["within"] for each in collection["features"]] == [3.0, 2.0, 1.0]
    assert "crs" in collection
    x, y = np.concatenate([np.array(ring) for polygon in found.polygons(3.0) for ring in polygon]).T
    low = (400_000.0, 4_999_840.0) if place else (-1.0, -1.0)
    assert (x.min(), y.min()) == low
    assert np.isnan(found.raster()[np.isinf(field)]).all()


def test_geojson_without_a_system_is_taken_in_the_map_s_on_another_body(tmp_path):
    moon = dem(Georeference(MOON, (2.0, 0.0, 1000.0, 0.0, -2.0, 500.0)))
    on_it = [(1010.0, 480.0), (1020.0, 470.0)]
    found, word = points_of(write(tmp_path / "a.geojson", on_it, None), moon)
    assert found.tolist() == list(map(list, on_it))
    assert "names no coordinate system: taken in the map's own" in word

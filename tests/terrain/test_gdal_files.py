"""Terrain files that lead elsewhere, or to more memory than there is: refused before GDAL follows
them.
"""

import sys

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio import Affine

from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.terrain.dem import read_dem
from tests.strategies import flat, uniform
from tests.terrain.test_dem import geotiff

HEIGHTS = uniform(4, (6, 9), 1, 90)
PLACE = {"transform": Affine(5, 0, 28e3, 0, -5, 39e3), "crs": "EPSG:3414"}


def raster(path, heights=HEIGHTS, **profile):
    return geotiff(path, heights, **PLACE, **profile)


def vrt(source):
    """A VRT of `HEIGHTS`' size whose band comes from an address."""
    return f"""<VRTDataset rasterXSize="9" rasterYSize="6"><GeoTransform>0, 2, 0, 0, 0, -2</GeoTransform>
        <VRTRasterBand dataType="Float32" band="1"><SimpleSource>
        <SourceFilename relativeToVRT="0">{source}</SourceFilename><SourceBand>1</SourceBand>
        </SimpleSource></VRTRasterBand></VRTDataset>"""


def refusal(path):
    with pytest.raises(TerrainError) as caught:
        read_dem(path, cell_size_m=1)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    return str(caught.value)


ADDRESS = "http://127.0.0.1:9"
WMS = f"""<?xml version="1.0"?><GDAL_WMS>
    <Service name="TMS"><ServerUrl>{ADDRESS}/${{z}}/${{x}}.png</ServerUrl></Service>
    <DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>6</UpperLeftY><LowerRightX>9</LowerRightX>
    <LowerRightY>0</LowerRightY><SizeX>9</SizeX><SizeY>6</SizeY><TileLevel>0</TileLevel></DataWindow>
    <BandsCount>1</BandsCount></GDAL_WMS>"""


@pytest.mark.parametrize("name", ["dem.tif", "dem.vrt", "dem.asc", "dem.png", "dem"])
def test_xml_is_refused_before_gdal_sees_it(tmp_path, name):
    for content in (vrt(f"/vsicurl/{ADDRESS}/dem.tif"), WMS):
        (tmp_path / name).write_text(content)
        assert "XML that names other files" in refusal(tmp_path / name)


@pytest.mark.parametrize("end", [".tif.msk", ".tif.ovr", ".aux"])
def test_what_lies_beside_a_raster_is_refused_before_gdal_sees_it(tmp_path, end):
    masked = '<Metadata><MDI key="INTERNAL_MASK_FLAGS_1">2</MDI></Metadata>'
    content = vrt(f"/vsicurl/{ADDRESS}/mask.tif").replace("<VRTRaster", f"{masked}<VRTRaster", 1)
    path = raster(tmp_path / "own.tif")
    path.with_name(f"own{end}").write_text(content)
    assert f"wanted a plain raster in own{end} beside it" in refusal(path)


LABEL = """PDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = 36\r\n^IMAGE = ("{file}", 1)\r
OBJECT = IMAGE\r\nLINES = 6\r\nLINE_SAMPLES = 9\r\nSAMPLE_TYPE = PC_REAL\r\nSAMPLE_BITS = 32\r
END_OBJECT = IMAGE\r\nEND\r\n"""


def test_a_label_that_leads_elsewhere_is_refused(tmp_path):
    (tmp_path / "inner").mkdir()
    for place in (tmp_path / "secret.img", tmp_path / "inner" / "own.img"):
        HEIGHTS.tofile(place)
    label = tmp_path / "inner" / "dem.lbl"
    label.write_text(LABEL.format(file="own.img"), newline="")
    np.testing.assert_array_equal(read_dem(label, cell_size_m=1).elevation, HEIGHTS)
    for file in ("../secret.img", f"{tmp_path}/secret.img"):
        label.write_text(LABEL.format(file=file), newline="")
        refusal(label)
    compressed = 'OBJECT = compressed_file\r\nFILE_NAME = "own.tif"\r\nEND_OBJECT\r\n'
    text = LABEL.format(file="own.img").replace("OBJECT", f"{compressed}OBJECT", 1)
    label.write_text(text, newline="")
    assert "an image that is not compressed" in refusal(label)


@pytest.mark.parametrize(
    ("name", "driver"),
    [("dem.bil", "EHdr"), ("dem.img", "HFA"), ("dem.asc", "AAIGrid")],
)
def test_the_formats_of_the_list_are_read_and_not_when_cut_short(tmp_path, name, driver):
    path = tmp_path / name
    rasterio.shutil.copy(raster(tmp_path / "source.tif"), path, driver=driver)
    dem = read_dem(path)
    np.testing.assert_allclose(dem.elevation, HEIGHTS, rtol=1e-6)
    assert dem.cell_size_m == 5
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    refusal(path)


def test_a_format_that_is_not_in_the_list_is_refused(tmp_path):
    raster(tmp_path / "dem.dat", driver="ENVI")
    assert "wanted GeoTIFF, ESRI ASCII grid" in refusal(tmp_path / "dem.dat")


def test_an_srtm_tile_is_read(tmp_path):
    levels = np.arange(1201 * 1201, dtype=">i2").reshape(1201, 1201) % 900
    (tmp_path / "N10E020.hgt").write_bytes(levels.astype(">i2").tobytes())
    np.testing.assert_array_equal(read_dem(tmp_path / "N10E020.hgt").elevation, levels)


def test_a_message_that_nobody_can_read_is_not_printed(tmp_path, capfd):
    """GDAL quotes the file's own bytes."""
    path = raster(tmp_path / "dem.img", driver="HFA")
    path.write_bytes(path.read_bytes().replace(b"{1:lversion", b"{1:\x81version"))
    hooks = sys.excepthook, sys.unraisablehook
    refusal(path)
    assert capfd.readouterr() == ("", "")
    assert (sys.excepthook, sys.unraisablehook) == hooks


def test_a_tiff_whose_directory_lies_beyond_its_end_is_one_line(tmp_path, capfd):
    """Sent so far, libtiff prints a line of its own."""
    for big, at, offset in (("NO", 4, b"\xff" * 4), ("YES", 8, b"\x0e\0\x03\0\x01\0\x01\0")):
        path = raster(tmp_path / f"{big}.tif", BIGTIFF=big)
        content = path.read_bytes()
        path.write_bytes(content[:at] + offset + content[at + len(offset) :])
        assert "directory lies beyond its end" in refusal(path)
    assert capfd.readouterr() == ("", "")


def test_memory_that_is_not_there_is_noticed_in_the_header(tmp_path, monkeypatch):
    """The file has 1 MB; its heights would have 4 TB, and a block 64 MiB."""
    side = 1 << 20
    path = tmp_path / "bomb.tif"
    tiles = {"tiled": True, "blockxsize": 1 << 12, "blockysize": 1 << 12}
    shape = {"height": side, "width": side, "count": 1, "dtype": "float32"}
    large = {"SPARSE_OK": True, "BIGTIFF": "YES"}
    with rasterio.open(path, "w", driver="GTiff", **shape, **large, **tiles, **PLACE):
        pass
    assert path.stat().st_size < 4e6
    assert "GB of memory for 1048576 × 1048576 float32 heights" in refusal(path)
    monkeypatch.setattr("nnpp_edge.terrain.array_files.available_bytes", lambda: 60e6)
    small = raster(tmp_path / "block.tif", flat(16, 16, 1.0), **tiles)
    assert "for 16 × 16 float32 heights, got 0.1 GB" in refusal(small)
    small = raster(tmp_path / "small.tif", flat(1000, 1000, 1.0))
    assert read_dem(small).shape == (1000, 1000)

"""Mappings: a bad one is refused by its key; packaged ones are good; the documentation has every key."""

from pathlib import Path

import pytest

from onboard.ground.log.bring_in import mapping
from onboard.ground.log.bring_in.errors import MappingError
from tests.ground.log.bring_in.recordings import CSV_MAPPING


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("scale = 0.01\n", "scale = 0.01\nscael = 1\n", "unknown key 'channel.imu.accel.scael'"),
        ("scale = 0.01\n", "", "'channel.imu.accel.scale' is missing"),
        ("scale = 0.01\n", "scale = -0.01\n", "channel.imu.accel.scale"),
        ("scale = 0.01\n", "scale = 1e43\n", "cannot be stored; correct the scale"),
        ("scale = 0.01\n", "scale = [1e-300, 1e300]\n", "cannot be stored; correct the scale"),
        ('unit = "g"', 'unit = "rad/s"', "'channel.imu.accel': .*unit 'rad/s' is not known here; use any of 'm/s"),
        ('unit = "rev"', 'unit = "furlong"', "unit 'furlong' is not known here"),
        ('"+z", "-x", "+y"', '"+z", "-x", "+x"', "must name each of x, y and z once"),
        ('columns = ["ax", "ay", "az"]', "", "give either `column`"),
        ('record = "scalar"', 'record = "tensor"', "channel.joint"),
        ('format = "csv"', 'format = "xls"', "mapping.format"),
        ("[mapping]", "[mapping", "not TOML"),
    ],
)
def test_a_bad_mapping_is_refused_by_its_key(bench, old, new, message):
    assert old in CSV_MAPPING
    (bench / "bad.toml").write_text(CSV_MAPPING.replace(old, new))
    with pytest.raises(MappingError, match=message) as raised:
        mapping.load(bench / "bad.toml")
    assert "bad.toml" in str(raised.value)


def test_a_mapping_that_is_not_there(tmp_path):
    with pytest.raises(MappingError, match="tudelft"):
        mapping.load("nobody")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(MappingError, match="UTF-8"):
        mapping.load(tmp_path / "binary.toml")


def test_every_packaged_mapping_is_good():
    names = mapping.packaged()
    assert "tudelft" in names
    for name in names:
        mapping.load(name)


def test_the_documentation_has_every_key_and_unit():
    page = (Path(__file__).resolve().parents[4] / "docs" / "import.md").read_text()
    sections = (mapping.About, mapping.Csv, mapping.Time, mapping.ImuChannel, mapping.ScalarChannel)
    for section in (*sections, mapping.VectorMapping, mapping.Scalar):
        for key in section.model_fields:
            assert f"`{key}`" in page, key
    assert all(f"`{unit}`" in page for unit in mapping.UNITS)
    assert all(f"`{name}`" in page for name in mapping.packaged())

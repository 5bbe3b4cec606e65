"""A flight's log in other people's hands: the stock ``mcap`` reader, ``mcap-ros2-support``, a Lichtblick layout."""

import json
import re
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.flight.missions import Result

LAYOUT = Path(__file__).resolve().parents[2] / "docs" / "lichtblick_rocksat.json"


def test_every_channel_of_a_flight_decodes_to_the_same_numbers(mission: Result) -> None:
    log = mission.log
    channels = log.channels
    seen = {name: {field: [] for field in dtype.names or ()} for name, dtype in channels.items()}
    with mission.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            assert message.log_time == decoded.host_ns
            for field, values in seen[channel.topic].items():
                values.append(getattr(decoded, field))
    assert sum(len(next(iter(fields.values()))) for fields in seen.values()) > 100_000
    for name, dtype in channels.items():
        rows = log.read(name)
        for field, values in seen[name].items():
            ours = rows[field].reshape(len(rows), *([dtype[field].shape[0]] if dtype[field].shape else []))
            if dtype[field].base.kind == "S":
                assert b"".join(values) == np.ascontiguousarray(rows[field]).tobytes(), f"{name}.{field}"
            else:
                theirs = np.array(values, ours.dtype).reshape(ours.shape)
                assert np.array_equal(ours, theirs, equal_nan=ours.dtype.kind == "f"), f"{name}.{field}"


def test_rosbags_decodes_every_channel(mission: Result) -> None:
    """It refuses a message with more than three bytes behind its last field."""
    store = get_typestore(Stores.EMPTY)
    seen: dict[str, list[int]] = {}
    with mission.path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert schema is not None
            if schema.name not in store.fielddefs:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            seen.setdefault(channel.topic, []).append(store.deserialize_cdr(message.data, schema.name).sequence)
    log = mission.log
    with_rows = [name for name in log.channels if len(log.read(name))]
    assert len(with_rows) > 10
    for name in with_rows:
        assert seen[name] == log.read(name)["sequence"].tolist(), name


def plotted() -> list[str]:
    configs = json.loads(LAYOUT.read_text(encoding="utf-8"))["configById"]
    return [path["value"] for panel in configs.values() for path in panel.get("paths", [])]


def test_the_lichtblick_layout_plots_what_a_flight_records(mission: Result) -> None:
    channels = mission.log.channels
    paths = plotted()
    assert len(paths) > 10
    for path in paths:
        match = re.fullmatch(r"(?P<topic>\w+)\.(?P<field>\w+)(?:\[(?P<index>\d+)\])?", path)
        assert match, path
        field = channels[match["topic"]][match["field"]]
        assert field.base.kind in "iuf", path
        assert (match["index"] is None) == (field.shape == ()), path
        assert match["index"] is None or int(match["index"]) < field.shape[0], path


def test_the_layout_shows_every_panel_it_describes() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))

    def panels(node: object) -> list[str]:
        if isinstance(node, dict):
            return panels(node["first"]) + panels(node["second"])
        return [str(node)]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])

"""Reads a log with mcap-ros2-support and with rosbags and compares every field with what was written (a JSON file)."""

import json
import math
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

LATCHED = {"/tf_static", "/camera/camera_info"}


def compare(where, expected, found):
    if isinstance(expected, dict):
        for name, value in expected.items():
            compare(f"{where}.{name}", value, getattr(found, name))
    elif isinstance(expected, list):
        assert len(expected) == len(found), f"{where}: expected {len(expected)} elements, found {len(found)}"
        for i, (one, other) in enumerate(zip(expected, found)):
            compare(f"{where}[{i}]", one, other)
    elif isinstance(expected, float):
        assert math.isclose(expected, float(found), rel_tol=1e-15, abs_tol=0.0), f"{where}: expected {expected}, found {found}"
    else:
        if isinstance(found, bytes):
            found = found[0]
        assert expected == found, f"{where}: expected {expected!r}, found {found!r}"


def check_mcap(log, expected):
    with open(log, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        messages = list(reader.iter_decoded_messages())
        attachments = [(a.name, a.media_type, a.data) for a in reader.iter_attachments()]
        metadata = [(m.name, m.metadata) for m in reader.iter_metadata()]
    assert attachments == [("session.toml", "application/toml", b"[camera]\n")], attachments
    assert metadata == [("session", {"field": "kid"})], metadata
    assert len(messages) == len(expected), f"expected {len(expected)} messages, found {len(messages)}"
    for written, (schema, channel, message, decoded) in zip(expected, messages):
        assert channel.topic == written["topic"]
        assert schema.name == written["type"]
        assert message.log_time == written["log_time"]
        compare(channel.topic, written["fields"], decoded)
    return len(messages)


def check_rosbags(log, expected):
    # Empty, so that every type comes from the definitions in the log.
    store = get_typestore(Stores.EMPTY)
    count = 0
    with Reader(Path(log)) as reader:
        for connection in reader.connections:
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
            durability = connection.ext.offered_qos_profiles[0].durability
            latched = durability == QosDurability.TRANSIENT_LOCAL
            assert latched == (connection.topic in LATCHED), f"{connection.topic}: {durability}"
        for written, (connection, timestamp, raw) in zip(expected, reader.messages()):
            assert (connection.topic, connection.msgtype) == (written["topic"], written["type"])
            assert timestamp == written["log_time"]
            compare(connection.topic, written["fields"], store.deserialize_cdr(raw, connection.msgtype))
            count += 1
    assert count == len(expected), f"expected {len(expected)} messages, found {count}"
    return count


if __name__ == "__main__":
    log, expected = sys.argv[1], json.loads(Path(sys.argv[2]).read_text())
    print("mcap-ros2-support:", check_mcap(log, expected), "messages agree")
    print("rosbags:", check_rosbags(log, expected), "messages agree")

"""Files of other programs."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import foxglove
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tests.support.files.recordings import MS, START


def foxglove_file(path: Path) -> Path:
    """100 JSON messages of foxglove-sdk."""
    with foxglove.open_mcap(str(path), context=(context := foxglove.Context())):
        pose = foxglove.Channel("/pose", message_encoding="json", context=context)
        for number in range(100):
            pose.log({"x": number}, log_time=START + number * MS)
    return path


def rosbag(folder: Path, plugin: StoragePlugin, *, packed: bool = False) -> Path:
    """100 messages of `rosbags`. `packed`: each message is compressed by itself."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"]
    bag = Writer(folder, version=9, storage_plugin=plugin)
    if packed:
        bag.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with bag as writer:
        chatter = writer.add_connection("/chatter", text.__msgtype__, typestore=store)
        for number in range(100):
            data = store.serialize_cdr(text(data=f"n{number}"), text.__msgtype__)
            writer.write(chatter, START + number * MS, data)
    return folder


def bag_of_topics(folder: Path, plugin: StoragePlugin, times: Mapping[str, Sequence[int]]) -> Path:
    """Messages of `rosbags` on several topics, at these milliseconds after START."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"]
    rows = sorted((time, topic) for topic, many in times.items() for time in many)
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        topics = {one: writer.add_connection(one, text.__msgtype__, typestore=store) for one in times}
        for time, topic in rows:
            writer.write(topics[topic], START + time * MS, store.serialize_cdr(text(data="x"), text.__msgtype__))
    return folder


def xdf_file(
    path: Path,
    samples: Sequence[tuple[float, Sequence[float]]],
    markers: Sequence[tuple[float, str]],
    names: Sequence[str] = ("EEG", "Marks"),
    third_stream: tuple[float, Sequence[float]] | None = None,
) -> Path:
    """An XDF file with a stream of numbers and a stream of markers.

    This function makes the bytes itself, because no package on PyPI writes XDF.
    """
    streams = {
        1: (names[0], "double64", [(stamp, struct.pack(f"<{len(row)}d", *row)) for stamp, row in samples]),
        2: (names[1], "string", [(stamp, _varlen(text.encode()) + text.encode()) for stamp, text in markers]),
    }
    if third_stream is not None:  # a third stream, with the name of the second one
        streams[3] = (
            names[1],
            "double64",
            [(third_stream[0], struct.pack(f"<{len(third_stream[1])}d", *third_stream[1]))],
        )
    content = b"XDF:" + _chunk(1, b'<?xml version="1.0"?><info><version>1.0</version></info>')
    for number, (name, kind, rows) in streams.items():
        count = len(samples[0][1]) if kind == "double64" else 1
        head = f"<info><name>{name}</name><type>{name.lower()}</type><channel_count>{count}</channel_count>"
        head += f"<nominal_srate>0</nominal_srate><channel_format>{kind}</channel_format></info>"
        content += _chunk(2, struct.pack("<I", number) + b'<?xml version="1.0"?>' + head.encode())
        body = b"".join(b"\x08" + struct.pack("<d", stamp) + data for stamp, data in rows)
        content += _chunk(3, struct.pack("<I", number) + b"\x04" + struct.pack("<I", len(rows)) + body)
    for number, (_, _, rows) in streams.items():
        foot = f'<?xml version="1.0"?><info><sample_count>{len(rows)}</sample_count></info>'
        content += _chunk(6, struct.pack("<I", number) + foot.encode())
    path.write_bytes(content)
    return path


def _varlen(data: bytes) -> bytes:
    return b"\x04" + struct.pack("<I", len(data))


def _chunk(tag: int, content: bytes) -> bytes:
    return b"\x04" + struct.pack("<IH", len(content) + 2, tag) + content

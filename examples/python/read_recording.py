#!/usr/bin/env python3
"""Reads a recording of Scanloop with programs of others: PyPI `mcap` and `rosbags`.

    read_recording.py RECORDING.mcap [BAG]

Prints one line per channel: name, type, messages. With a folder from `scanloop recording export --rosbag2 BAG`, each
message is decoded, encoded again and compared byte for byte.
"""

import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def channels(path):
    """Messages per channel and type, as the MCAP library of Foxglove reads them."""
    counts = Counter()
    with open(path, "rb") as file:
        for schema, channel, _ in make_reader(file, validate_crcs=True).iter_messages():
            counts[channel.topic, schema.name] += 1
    return counts


def changed(bag):
    """Messages of a bag of ROS 2 that are not the same bytes when they are decoded and encoded again."""
    types = get_typestore(Stores.EMPTY)
    differ = Counter()
    with Reader(bag) as reader:
        for connection in reader.connections:
            known = types.fielddefs
            new = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            types.register({name: fields for name, fields in new.items() if name not in known})
        for connection, _, data in reader.messages():
            message = types.deserialize_cdr(data, connection.msgtype)
            if bytes(types.serialize_cdr(message, connection.msgtype)) != bytes(data):
                differ[connection.topic] += 1
    return differ


def main():
    for (topic, schema), count in sorted(channels(sys.argv[1]).items()):
        print(f"{topic} {schema} {count}")
    if len(sys.argv) > 2:
        differ = changed(Path(sys.argv[2]))
        if differ:
            sys.exit(f"not the same when they are encoded again: {dict(differ)}")
        print("all messages are the same when they are encoded again")


if __name__ == "__main__":
    main()

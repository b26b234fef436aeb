"""Opens every file of a repaired session, and the session as a whole, with readers that are not ours."""

import sys
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

IMAGE = "/camera/image/compressed"

if __name__ == "__main__":
    session, frames = Path(sys.argv[1]), int(sys.argv[2])
    found = 0
    for path in sorted(session.glob("*.mcap")):
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True)
            counted = sum(1 for _ in reader.iter_messages())
            assert reader.get_summary().statistics.message_count == counted, path
            found += sum(1 for _ in reader.iter_messages(topics=[IMAGE]))
    assert found == frames, f"mcap finds {found} frames of {frames}"
    with Reader(session) as bag:
        images = [connection for connection in bag.connections if connection.topic == IMAGE]
        found = sum(1 for _ in bag.messages(connections=images))
        total = sum(1 for _ in bag.messages())
        assert bag.message_count == total, (bag.message_count, total)
    assert found == frames, f"rosbags finds {found} frames of {frames}"

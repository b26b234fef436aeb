"""The soak's stream with the Python reference writer, which syncs nothing by itself: what it costs beside ours.

    reference_writer.py FILE SECONDS [FRAMES_PER_S] [FRAME_KIB] [IMU_PER_S]
"""

import json
import os
import sys
import time

from mcap.writer import CompressionType, Writer

if __name__ == "__main__":
    path, seconds = sys.argv[1], float(sys.argv[2])
    rate, frame_kib, imu = (int(text) for text in (sys.argv[3:] + ["60", "80", "500"][len(sys.argv) - 3 :]))
    frame, sample = os.urandom(frame_kib * 1024), bytes(324)
    written, stall = 0, 0.0
    began, used, synced = time.monotonic(), time.process_time(), time.monotonic()
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema(name="raw", encoding="ros2msg", data=b"")
        image = writer.register_channel(topic="/image", message_encoding="cdr", schema_id=schema)
        inertial = writer.register_channel(topic="/imu", message_encoding="cdr", schema_id=schema)
        frames = samples = 0
        while (now := time.monotonic() - began) < seconds:
            while samples / imu <= now:
                writer.add_message(inertial, log_time=int(samples / imu * 1e9), publish_time=0, data=sample)
                samples += 1
            while frames / rate <= now:
                writer.add_message(image, log_time=int(frames / rate * 1e9), publish_time=0, data=frame)
                frames += 1
            if time.monotonic() - synced >= 0.5:
                # Its open chunk stays in memory; what it has handed over is forced to the disk as ours is.
                synced = time.monotonic()
                file.flush()
                os.fdatasync(file.fileno())
                stall = max(stall, time.monotonic() - synced)
            time.sleep(max(0.0, min(samples / imu, frames / rate) - (time.monotonic() - began)))
        writer.finish()
    elapsed = time.monotonic() - began
    share = (time.process_time() - used) / elapsed
    print(json.dumps({"frames": frames, "core_share": share, "worst_stall_ms": 1e3 * stall}))

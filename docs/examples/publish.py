"""Publishes a folder of JPEG files as a camera. Needs `pip install eclipse-zenoh` and nothing of albireo.

Usage: publish.py FOLDER [KEY] [ENDPOINT]
"""

import json
import pathlib
import sys
import time

import zenoh

folder = pathlib.Path(sys.argv[1])
key = sys.argv[2] if len(sys.argv) > 2 else "albireo/node/front/frame"
endpoint = sys.argv[3] if len(sys.argv) > 3 else "tcp/127.0.0.1:7447"
rate = 25.0  # that of the recorded road

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))

with zenoh.open(config) as session:
    publisher = session.declare_publisher(key, encoding="image/jpeg")
    # A session that has just been opened does not know its subscribers yet.
    while not publisher.matching_status.matching:
        time.sleep(0.05)
    start = time.monotonic()
    for seq, file in enumerate(sorted(folder.glob("*.jpg"))):
        # Without the attachment frames are numbered by arrival, and clips are windows of time.
        attachment = {"v": 1, "seq": seq, "t_ns": time.time_ns(), "clip": folder.name}
        publisher.put(file.read_bytes(), attachment=json.dumps(attachment))
        time.sleep(max(0.0, start + (seq + 1) / rate - time.monotonic()))
    print(f"{seq + 1} frames sent on {key}")

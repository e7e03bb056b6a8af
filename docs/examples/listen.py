"""Prints what a node finds. Needs `pip install eclipse-zenoh` and nothing of albireo.

Usage: listen.py [KEY] [ENDPOINT] [MESSAGES]
"""

import json
import sys

import zenoh

key = sys.argv[1] if len(sys.argv) > 1 else "albireo/node/*/detections"
endpoint = sys.argv[2] if len(sys.argv) > 2 else "tcp/127.0.0.1:7447"
wanted = int(sys.argv[3]) if len(sys.argv) > 3 else None

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))

with zenoh.open(config) as session, session.declare_subscriber(key) as subscriber:
    for count, sample in enumerate(subscriber, start=1):
        message = json.loads(sample.payload.to_bytes())
        boxes = ", ".join(f"{box['class']} {box['confidence']:.2f} {box['source']}" for box in message["boxes"])
        print(f"{message['seq']} {message['state']}: {boxes or 'nothing'}", flush=True)
        if count == wanted:
            break

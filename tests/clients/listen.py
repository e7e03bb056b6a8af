"""An independent client of a node: it uses Eclipse Zenoh's Python binding and no code of albireo.

Usage: listen.py ENDPOINT KEY [--history]

Prints `ready` once it has seen the node's liveliness token and subscribed, then a JSON line
{"key": ..., "message": ...} for every JSON message under KEY (frames are left out), until its standard input closes.
`--history` also requests messages published earlier (clip reports).
"""

import json
import sys
import threading

import zenoh
from zenoh import ext


def main() -> None:
    endpoint, key = sys.argv[1], sys.argv[2]
    history = "--history" in sys.argv[3:]
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", json.dumps([endpoint]))
    configuration.insert_json5("scouting/multicast/enabled", "false")

    write = threading.Lock()
    ready = threading.Event()

    def received(sample: zenoh.Sample) -> None:
        if str(sample.key_expr).endswith("/frame"):
            return
        message = json.loads(sample.payload.to_bytes())
        # The history may arrive before all subscriptions exist.
        ready.wait()
        with write:
            print(json.dumps({"key": str(sample.key_expr), "message": message}), flush=True)

    with zenoh.open(configuration) as session:
        if history:
            subscriber = ext.declare_advanced_subscriber(
                session,
                key,
                zenoh.handlers.Callback(received),
                history=ext.HistoryConfig(detect_late_publishers=True),
            )
        else:
            subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(received))
        node = "/".join(key.split("/")[:2])
        alive = session.liveliness().declare_subscriber("{}/@alive/{}".format(*node.rsplit("/", 1)), history=True)
        alive.recv()
        print("ready", flush=True)
        ready.set()
        sys.stdin.read()
        subscriber.undeclare()


main()

"""A Zenoh router in a separate process: it uses Eclipse Zenoh's Python binding and no code of albireo.

Usage: router.py ENDPOINT [CONFIGURATION]

Listens on ENDPOINT with the settings of a configuration file (config/zenoh-router.json5), prints `ready`, and runs until it is
killed.
"""

import json
import signal
import sys

import zenoh


def main() -> None:
    configuration = zenoh.Config.from_file(sys.argv[2]) if len(sys.argv) > 2 else zenoh.Config()
    configuration.insert_json5("mode", '"router"')
    configuration.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
    configuration.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(configuration):
        print("ready", flush=True)
        signal.sigwait([signal.SIGTERM, signal.SIGINT])


main()

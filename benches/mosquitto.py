"""A yardstick for a broker's cost: Mosquitto with the fleet's rate and sizes of messages.

Usage: mosquitto.py NODES CONNECTIONS SECONDS

A status of some bytes each 30 s a node and a batch of eight reports each 320 s, published with QoS 1 through Mosquitto (Debian's
package) on this machine to one subscriber. Prints what the broker used. As in benches/fleet.sh nothing is written to disk by it.
"""

import os
import random
import subprocess
import sys
import tempfile
import threading
import time

import paho.mqtt.client as mqtt

PORT = 17883
STATUS_BYTES = 90
BATCH_BYTES = 2_600
# Seconds between the messages of a node.
STATUS_S = 30
BATCH_S = 320


def cpu_seconds(pid: int) -> float:
    fields = open(f"/proc/{pid}/stat").read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    return int(open(f"/proc/{pid}/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def client(name: str) -> mqtt.Client:
    made = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=name)
    made.max_inflight_messages_set(2000)
    made.connect("127.0.0.1", PORT)
    made.loop_start()
    return made


def main() -> None:
    nodes, connections, seconds = (int(argument) for argument in sys.argv[1:4])
    with tempfile.NamedTemporaryFile("w", suffix=".conf") as config:
        config.write(f"listener {PORT} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\nmax_inflight_messages 0\n")
        config.flush()
        os.chmod(config.name, 0o644)
        broker = subprocess.Popen(["mosquitto", "-c", config.name], stderr=subprocess.DEVNULL)
        try:
            time.sleep(1)
            received = 0
            lock = threading.Lock()

            def count(*_: object) -> None:
                nonlocal received
                with lock:
                    received += 1

            hub = client("hub")
            hub.on_message = count
            hub.subscribe("albireo/#", qos=1)
            sessions = [client(f"s{index}") for index in range(connections)]
            time.sleep(1)
            node_rate = 1 / STATUS_S + 1 / BATCH_S
            rate = nodes * node_rate
            before = cpu_seconds(broker.pid)
            begun = time.monotonic()
            passed = 0.0
            sent = 0
            while passed < seconds:
                while sent < passed * rate:
                    node = random.randrange(nodes)
                    is_batch = random.random() < 1 / BATCH_S / node_rate
                    payload = b"b" * BATCH_BYTES if is_batch else b"s" * STATUS_BYTES
                    sessions[node % connections].publish(f"albireo/@status/{node}", payload, qos=1)
                    sent += 1
                time.sleep(0.02)
                passed = time.monotonic() - begun
            used = cpu_seconds(broker.pid) - before
            print(
                f"mosquitto: {sent} messages of {nodes} nodes on {connections} connections in {seconds} s "
                f"({rate:.0f} a second), {received} received, {100 * used / seconds:.1f} % of a core, {resident_mb(broker.pid):.0f} MB"
            )
        finally:
            broker.terminate()
            broker.wait()


main()

"""How long a hub's interface takes to answer: benches/fleet_api.py HUB SECONDS. One request after the other, ten per second."""

import sys
import time
import urllib.request

hub, seconds = sys.argv[1], float(sys.argv[2])
now_ms = int(time.time() * 1000)
paths = {
    "a page of nodes": "/api/v1/nodes?limit=50",
    "nodes, worst first": "/api/v1/nodes?limit=50&sort=state&down=true",
    "one node": "/api/v1/nodes/sim-000007",
    "last clips of a node": "/api/v1/clips?node=sim-000007&limit=20",
    "last clips": "/api/v1/clips?limit=50",
    "energy of the fleet": "/api/v1/energy",
    "metrics": "/metrics",
}
times = {name: [] for name in paths}
until = time.monotonic() + seconds
while time.monotonic() < until:
    for name, path in paths.items():
        begun = time.perf_counter()
        with urllib.request.urlopen(hub + path) as answer:
            answer.read()
        times[name].append((time.perf_counter() - begun) * 1000)
        time.sleep(0.1)
for name, found in times.items():
    found.sort()
    p99 = found[min(len(found) - 1, int(len(found) * 0.99))]
    print(f"{name:<22} p50 {found[len(found) // 2]:7.1f} ms  p99 {p99:7.1f} ms  of {len(found)}")

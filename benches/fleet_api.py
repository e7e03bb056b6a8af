"""How long a hub's interface takes to answer: benches/fleet_api.py HUB SECONDS. One request after the other, at most twenty per second."""

import sys
import time
import urllib.request

hub = sys.argv[1]
seconds = float(sys.argv[2])
HOUR = 3_600_000
DAY = 24 * HOUR
now_ms = int(time.time() * 1000)
# The begin of this hour and of this day.
hour = now_ms // HOUR * HOUR
day = now_ms // DAY * DAY
node = "sim-000007"
# What the pages ask.
paths = {
    "counts of nodes": "/api/v1/nodes?limit=0",
    "a page of nodes": "/api/v1/nodes?limit=50",
    "nodes, worst first": "/api/v1/nodes?limit=50&sort=state&down=true",
    "nodes, most energy": "/api/v1/nodes?limit=50&sort=joules&down=true",
    "one node": f"/api/v1/nodes/{node}",
    "last clips of a node": f"/api/v1/clips?node={node}&limit=30",
    "energy of a node": f"/api/v1/energy?by=threshold&node={node}&since_ms={hour - 168 * HOUR}",
    "revisions of a node": f"/api/v1/revisions?node={node}&limit=10",
    "last clips": "/api/v1/clips?limit=50",
    "energy, five minutes": f"/api/v1/energy?since_ms={now_ms - 600_000}&until_ms={now_ms - 300_000}",
    "energy, an hour": f"/api/v1/energy?since_ms={hour - HOUR}&until_ms={hour}",
    "energy, a day": f"/api/v1/energy?since_ms={day - 24 * HOUR}&until_ms={day}",
    "energy, 30 days": f"/api/v1/energy?by=threshold&since_ms={day - 720 * HOUR}",
    "revisions": "/api/v1/revisions?limit=50",
    "rollouts": "/api/v1/rollouts",
    "set aside": "/api/v1/set-aside?limit=100",
    "drift": "/api/v1/drift",
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
        time.sleep(0.05)
for name, found in times.items():
    found.sort()
    p99 = found[min(len(found) - 1, int(len(found) * 0.99))]
    print(f"{name:<22} p50 {found[len(found) // 2]:7.1f} ms  p99 {p99:7.1f} ms  of {len(found)}")

"""Runs a node under faults for a long time: `make soak` (30 minutes), or soak.py --minutes 2 for a trial.

A node behind a router, a hub, and a subscriber. Of the node's five cameras two are right, one sends the same picture for ever,
one puts wrong stamps on its frames, and one loses 3 % of the packets of its video (by HTTP, decoded by ffmpeg). The faults: corrupt frames, cameras that restart, a router
that is killed and comes back, a detector that hangs (the fixture's model never finishes on a bright picture; the node exits
after 30 s, and the script restarts it like a service manager), a subscriber that stops reading, and a node and a hub killed with -9.
What ends the node or the hub happens in the first half only, so that both have a long run. At the end the hub must have every
report of the node exactly once. Prints the counts, and memory, threads and descriptors over time.
"""

import argparse
import atexit
import http.server
import json
import os
import pathlib
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

import numpy
import zenoh

ROOT = pathlib.Path(__file__).parent.parent
WIDTH, HEIGHT = 64, 32
# Those that send frames, and the one whose video the node opens.
CAMERAS = ["front", "rear", "frozen", "stamped"]
LOSSY = "lossy"

NODE = """
[node]
name = "soak"
state_dir = "{folder}/state"
[zenoh]
mode = "client"
listen = []
connect = ["{router}"]
[uplink]
connect = ["{uplink}"]
[http]
listen = "127.0.0.1:{http}"
[detector]
model = "{model}"
timeout_ms = 300
[policy]
u = 1e-3
[screen]
still_s = 10.0
[clip]
window_s = 10.0
silence_s = 5.0
[[camera]]
name = "front"
[[camera]]
name = "rear"
[[camera]]
name = "frozen"
[[camera]]
name = "stamped"
[[camera]]
name = "lossy"
source = "http://127.0.0.1:{video}/video.ts"
# Damage may be bright, which hangs the detector: only a corner is left, as a mask must leave something.
mask = [[[0.0, 0.0], [1.0, 0.0], [1.0, 0.95], [0.0, 0.95]], [[0.0, 0.95], [0.95, 0.95], [0.95, 1.0], [0.0, 1.0]]]
"""

HUB = """
[zenoh]
listen = ["{uplink}"]
[http]
listen = "127.0.0.1:{http}"
[database]
url = "sqlite:{folder}/hub.db"
"""


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def configuration(mode, **settings):
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for key, value in settings.items():
        config.insert_json5(key.replace("__", "/"), json.dumps(value))
    return config


def client(endpoint):
    return configuration(
        "client",
        connect__endpoints=[endpoint],
        connect__timeout_ms=-1,
        connect__exit_on_failure=False,
        connect__retry={"period_init_ms": 100, "period_max_ms": 1000},
    )


def as_router(endpoint):
    with zenoh.open(configuration("router", listen__endpoints=[endpoint])):
        sys.stdin.read()


def as_subscriber(endpoint):
    with zenoh.open(client(endpoint)) as session:
        with session.declare_subscriber("albireo/**", zenoh.handlers.Callback(lambda sample: None)):
            sys.stdin.read()


def get(url):
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.read()


class Child:
    """A process that can be killed and started again."""

    def __init__(self, command, log):
        self.command, self.log, self.process = command, open(log, "ab"), None
        self.start()
        atexit.register(lambda: self.process.kill())

    def start(self):
        self.process = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=self.log, stderr=self.log)

    def bounce(self, pause):
        self.process.kill()
        self.process.wait()
        time.sleep(pause)
        self.start()

    def end(self, limit=30):
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(limit)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return "killed"


def stamp(seq, random_):
    """A wrong capture time: it stands still, goes back, jumps by years, or is far too fast."""
    return int([7, 10**9 * (1000 - seq % 1000), random_.integers(0, 2**62), seq * 10**12][seq // 100 % 4])


def lossy_video(folder):
    """Serves a video for ever, at its own pace, without 3 % of its packets; returns the port."""
    file = folder / "video.ts"
    pictures = "testsrc2=size=320x180:rate=10:duration=20,hue=s=0,lutyuv=y=16+(val-16)*0.2"
    encode = ["-c:v", "libx264", "-preset", "ultrafast", "-g", "10", "-pix_fmt", "yuv420p", "-f", "mpegts", str(file)]
    subprocess.run(["ffmpeg", "-v", "error", "-f", "lavfi", "-i", pictures, *encode], check=True)
    data = file.read_bytes()
    packets = [data[start : start + 188] for start in range(0, len(data), 188)]

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("content-type", "video/mp2t")
            self.end_headers()
            chance, begun, sent = random.Random(3), time.monotonic(), 0
            try:
                while True:
                    packet = packets[sent % len(packets)]
                    # At first all come: what was never seen would be green, and bright.
                    if sent < len(packets) // 2 or chance.random() >= 0.03:
                        self.wfile.write(packet)
                    sent += 1
                    time.sleep(max(0.0, begun + sent * 20 / len(packets) - time.monotonic()))
            except OSError:
                pass

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server.server_port


class Camera(threading.Thread):
    """Sends ten frames per second, of which some are corrupt and some bright."""

    def __init__(self, name, endpoint, done):
        super().__init__(daemon=True)
        self.name_, self.endpoint, self.done = name, endpoint, done
        self.restart, self.bright = threading.Event(), threading.Event()
        self.sent = self.corrupt = self.hangs = self.restarts = 0

    def run(self):
        random_ = numpy.random.default_rng(len(self.name_))
        while not self.done.is_set():
            with zenoh.open(client(self.endpoint)) as session:
                publisher = session.declare_publisher(f"albireo/soak/{self.name_}/frame")
                seq = 0
                self.restart.clear()
                due = time.monotonic()
                while not (self.done.is_set() or self.restart.is_set()):
                    attachment = {"v": 1, "seq": seq, "width": WIDTH, "height": HEIGHT}
                    encoding = "image/raw;gray8"
                    payload = random_.integers(0, 100, WIDTH * HEIGHT, numpy.uint8).tobytes()
                    if self.name_ == "frozen":
                        payload = bytes(60 + place % 40 for place in range(WIDTH * HEIGHT))
                    if self.name_ == "stamped":
                        attachment["t_ns"] = stamp(seq, random_)
                    # In a restart it might be lost.
                    if self.bright.is_set() and seq > 20:
                        self.bright.clear()
                        payload, self.hangs = b"\xff" * len(payload), self.hangs + 1
                    elif seq % 50 == 25:
                        payload, encoding = b"\xff\xd8\xff\xe0 and no more", "image/jpeg"
                        self.corrupt += 1
                    publisher.put(payload, encoding=encoding, attachment=json.dumps(attachment))
                    seq, self.sent, due = seq + 1, self.sent + 1, due + 0.1
                    time.sleep(max(0.0, due - time.monotonic()))
            self.restarts += 1


def memory(pid):
    with open(f"/proc/{pid}/status") as status:
        fields = dict(line.split(":", 1) for line in status)
    return int(fields["VmRSS"].split()[0]) / 1024, int(fields["Threads"]), len(os.listdir(f"/proc/{pid}/fd"))


def growth(process, samples):
    """How much memory a process took over its longest run, and whether it grew steadily."""
    third = samples[0][0] + (samples[-1][0] - samples[0][0]) / 3
    rest = numpy.array([sample for sample in samples if sample[0] > third])
    slope = numpy.polyfit(rest[:, 0] / 3600, rest[:, 1], 1)[0]
    return (
        f"{process}, longest run of {samples[-1][0] - samples[0][0]:.0f} s: {samples[0][1]:.1f} MiB, "
        f"{rest[0][1]:.1f} after a third, {samples[-1][1]:.1f} at the end ({slope:+.1f} MiB/h over the last two thirds); "
        f"threads {samples[0][2]} to {samples[-1][2]}, descriptors {samples[0][3]} to {samples[-1][3]}"
    )


def until_alive(url):
    """Waits until a service answers."""
    deadline = time.monotonic() + 30
    while True:
        try:
            return get(url)
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def stored(hub):
    """The counts of the reports that the hub lists."""
    found, cursor = [], ""
    while True:
        page = json.loads(get(f"{hub}/api/v1/clips?node=soak&limit=1000{cursor}"))
        for clip in page["clips"]:
            found.append(clip["count"])
        if page.get("next") is None:
            return found
        cursor = f"&cursor={page['next']}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--program", default=str(ROOT / "target/debug/albireo"))
    arguments = parser.parse_args()

    folder = pathlib.Path(tempfile.mkdtemp(prefix="soak-"))
    router_at, uplink_at = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    node_http, hub_http = free_port(), free_port()
    places = {"folder": folder, "router": router_at, "uplink": uplink_at, "video": lossy_video(folder)}
    model = ROOT / "tests/fixtures/models/hanging.onnx"
    (folder / "node.toml").write_text(NODE.format(http=node_http, model=model, **places))
    (folder / "hub.toml").write_text(HUB.format(http=hub_http, **places))
    here = [sys.executable, __file__]
    hub = Child([arguments.program, "hub", "--config", folder / "hub.toml"], folder / "hub.log")
    router = Child([*here, "--router", router_at], folder / "router.log")
    node = Child([arguments.program, "node", "--config", folder / "node.toml"], folder / "node.log")
    subscriber = Child([*here, "--subscriber", router_at], folder / "subscriber.log")

    answers, done = {name: 0 for name in [*CAMERAS, LOSSY]}, threading.Event()

    def answered(sample):
        answers[str(sample.key_expr).split("/")[2]] += 1

    listener = zenoh.open(client(router_at))
    listening = listener.declare_subscriber("albireo/soak/*/detections", zenoh.handlers.Callback(answered))
    cameras = [Camera(name, router_at, done) for name in CAMERAS]
    for camera in cameras:
        camera.start()

    chance, begun = random.Random(5), time.monotonic()
    counts = dict.fromkeys(["router", "hub", "deaf", "kill", "node", "damage", "slow health"], 0)
    # Samples of each run of the node and of the hub.
    runs, hub_runs, deaf_until = [[]], [[]], None
    health = f"http://127.0.0.1:{node_http}/healthz"
    until_alive(health)
    # Seconds between two faults of a kind.
    every = {"sample": 5, "table": 600, "restart": 47, "bright": 580, "router": 97, "hub": 131, "deaf": 83, "kill": 211}
    ends_a_run = {"bright", "hub", "kill"}
    due = {kind: seconds * 0.7 for kind, seconds in every.items()}
    print(f"soak of {arguments.minutes:g} minutes; logs in {folder}", flush=True)
    while (now := time.monotonic() - begun) < arguments.minutes * 60:
        first_half = now < arguments.minutes * 30
        for kind in [kind for kind in due if due[kind] <= now]:
            due[kind] = now + every[kind]
            if kind in ends_a_run and not first_half:
                continue
            if kind == "sample":
                asked = time.monotonic()
                try:
                    get(health)
                except OSError:
                    # Either the node is exiting, or it should have answered.
                    time.sleep(1)
                    counts["slow health"] += node.process.poll() is None
                    continue
                counts["slow health"] += time.monotonic() - asked > 1.0
                runs[-1].append((now, *memory(node.process.pid)))
                hub_runs[-1].append((now, *memory(hub.process.pid)))
            elif kind == "table":
                print(f"{now / 60:.0f} min, load {os.getloadavg()[1]:.1f}", end="")
                for process, samples in [("node", runs[-1]), ("hub", hub_runs[-1])]:
                    for _, size, threads, descriptors in samples[-1:]:
                        print(f"; {process} {size:.1f} MiB, {threads} threads, {descriptors} descriptors", end="")
                print(flush=True)
            elif kind == "restart":
                chance.choice(cameras).restart.set()
            elif kind == "bright":
                chance.choice(cameras).bright.set()
            elif kind == "router":
                counts["router"] += 1
                router.bounce(chance.choice([0.5, 3.0]))
            elif kind == "hub":
                counts["hub"] += 1
                hub.bounce(chance.choice([1.0, 8.0]))
                hub_runs.append([])
            # A node with a hanging detector has to end by itself.
            elif kind == "kill" and counts["node"] - counts["damage"] == sum(camera.hangs for camera in cameras):
                counts["kill"] += 1
                node.bounce(chance.choice([0.0, 2.0]))
                until_alive(health)
                runs.append([])
            elif kind == "deaf":
                counts["deaf"] += 1
                subscriber.process.send_signal(signal.SIGSTOP)
                deaf_until = now + 25
        if deaf_until and now > deaf_until:
            subscriber.process.send_signal(signal.SIGCONT)
            deaf_until = None
        time.sleep(0.2)
        if node.process.poll() is not None:
            counts["node"] += 1
            # A bright picture of the lossy camera, too, hangs the detector.
            counts["damage"] += counts["node"] - counts["damage"] > sum(camera.hangs for camera in cameras)
            if node.process.returncode != 1 or "has not come back" not in (folder / "node.log").read_text()[-5000:]:
                sys.exit(f"the node exited unexpectedly with {node.process.returncode}: see {folder}/node.log")
            node.start()
            until_alive(health)
            runs.append([])

    subscriber.process.send_signal(signal.SIGCONT)
    done.set()
    for camera in cameras:
        camera.join(30)
    time.sleep(1)
    states = json.loads(get(f"http://127.0.0.1:{node_http}/api/v1/frame-states"))
    listed = json.loads(get(f"http://127.0.0.1:{node_http}/api/v1/cameras"))
    passed = [
        float(line.split()[-1]) for line in get(f"http://127.0.0.1:{node_http}/metrics").decode().splitlines()
        if line.startswith('albireo_frames_passed_total{camera="frozen",cause="unchanged"}')
    ]
    asked = time.monotonic()
    code = node.end()
    stopping = time.monotonic() - asked
    # Reports of the last clips wait in the outbox; the node starts once more to deliver them.
    node.start()
    deadline, previous = time.monotonic() + 60, None
    while time.monotonic() < deadline:
        time.sleep(2)
        found = stored(f"http://127.0.0.1:{hub_http}")
        waiting = [
            line for line in get(f"http://127.0.0.1:{node_http}/metrics").decode().splitlines()
            if line.startswith("albireo_outbox_reports ") or line.startswith("albireo_outbox_waiting")
        ]
        total = len(found)
        if total == previous and all(float(line.split()[-1]) == 0 for line in waiting):
            break
        previous = total
    node.end()
    listening.undeclare()
    listener.close()
    for child in (subscriber, router, hub):
        child.end()

    failures = []
    print(json.dumps({"states": states, "cameras": listed}, indent=1))
    for camera in cameras:
        print(
            f"{camera.name_}: {camera.sent} frames sent, {answers[camera.name_]} answers seen, {camera.corrupt} corrupt, "
            f"{camera.hangs} that hang the detector, {camera.restarts} restarts"
        )
    broken = next(camera["broken"] for camera in listed["cameras"] if camera["camera"] == LOSSY)
    frozen = sum(passed)
    print(f"{LOSSY}: {answers[LOSSY]} answers seen, {broken} frames broken in the last run; frozen: {frozen:.0f} frames passed over")
    if not broken:
        failures.append("no frame of the lossy camera was broken")
    if not frozen:
        failures.append("no frame of the frozen camera was passed over")
    silent = [name for name, count in answers.items() if not count]
    if silent:
        failures.append(f"no answers from {', '.join(silent)}")
    if sorted(found) != list(range(1, len(found) + 1)):
        failures.append("a report is missing or duplicated")
    if not found:
        failures.append("no report reached the hub")
    if counts["node"] - counts["damage"] != sum(camera.hangs for camera in cameras):
        failures.append("a hanging detector did not end the node")
    print(
        f"{len(found)} reports; faults: {counts['router']} router bounces, {counts['hub']} hubs killed, {counts['kill']} nodes killed, {counts['deaf']} "
        f"subscriber pauses, {counts['node']} detector hangs, {counts['damage']} of them by damage"
    )
    if counts["slow health"]:
        failures.append(f"health took more than a second {counts['slow health']} times")
    print(growth("node", max(runs, key=len)))
    print(growth("hub", max(hub_runs, key=len)))
    print(f"exit {code} in {stopping:.2f} s")
    if code != 0:
        failures.append(f"the node's exit code was {code}")
    print("\n".join(failures) or "every report was stored once")
    sys.exit(1 if failures else 0)


if sys.argv[1:2] == ["--router"]:
    as_router(sys.argv[2])
elif sys.argv[1:2] == ["--subscriber"]:
    as_subscriber(sys.argv[2])
else:
    main()

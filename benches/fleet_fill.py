"""Fills a hub's new SQLite file with clips of past days: benches/fleet_fill.py FILE NODES DAYS CLIPS_A_DAY.

Each node `sim-NNNNNN` has one camera that drives once a day, so its clips of 40 s follow each other, with an audit. Prints what a clip
takes on the disk. `albireo hub move` takes the file to PostgreSQL."""

import os
import re
import sqlite3
import sys
import time

SQL = os.path.join(os.path.dirname(__file__), "../crates/hub/src/store")
DAY_MS = 86_400_000
# What a clip has, from its number `n`, its camera `c`, its begin `at_ms` and a random number `r`.
VALUES = {
    "id": "NULL", "day": f"at_ms / {DAY_MS}", "report_id": "CAST(unhex(printf('%012x7', at_ms)) || randomblob(9) AS BLOB)",
    "count": "n + 1", "camera_id": "c", "setup_id": "c % 40 + 1", "at_ms": "at_ms", "received_ms": "at_ms + 41000 + r % 3000",
    "clip": "'window-' || n", "part": "0", "ended_by": "'window'", "duration_us": "40000000 + r % 1000", "frames": "400",
    "frames_e": "r % 60 + 60", "frames_p": "300 - r % 60", "frames_ei": "8", "frames_i": "32", "frames_ai": "0", "degraded": "0",
    "dropped": "0", "latency_mean_us": "4100 + r % 900", "latency_p99_us": "28000 + r % 5000",
    "latency_us": "(4100 + r % 900) * 400", "detector_calls": "120 + r % 60", "detector_mean_us": "18900 + r % 3000",
    "detector_us": "(18900 + r % 3000) * (120 + r % 60)", "avoided_calls": "220 + r % 60",
    "avoided_uj": "90000000 + r % 40000000", "quality": "0", "energy_uj": "250000000 + r % 90000000",
    "node_uj": "250000000 + r % 90000000", "edp": "25.0 + (r % 100000) / 7919.0", "coverage_ppm": "1000000",
    "threshold_changed": "0", "audit_frames": "4", "audit_missed": "0", "audit_missed_boxes": "0", "audit_calls": "4",
    "audit_us": "72000 + r % 20000", "audit_uj": "1500000 + r % 400000", "audit_detected": "14 + r % 9",
    "audit_shown": "14 + r % 8", "audit_paired": "13 + r % 8", "audit_detected_sq": "60 + r % 60",
    "audit_detected_x": "58 + r % 50", "audit_shown_sq": "60 + r % 50", "audit_paired_sq": "52 + r % 50",
    "audit_shown_x": "55 + r % 50",
}
COUNTING = "WITH RECURSIVE k(c) AS (SELECT 1 UNION ALL SELECT c + 1 FROM k WHERE c < {})"


def read(name):
    with open(os.path.join(SQL, name)) as file:
        return file.read()


file, nodes, days, clips = sys.argv[1], *map(int, sys.argv[2:5])
db = sqlite3.connect(file)
db.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; PRAGMA cache_size = -2000000; PRAGMA temp_store = MEMORY;")
db.executescript(read("schema/sqlite.sql"))
# A blob is made by hand where SQLite is older than `unhex`.
db.create_function("unhex", 1, lambda text: bytes.fromhex(text.ljust(14, "0")))
db.execute(COUNTING.format(nodes) + "INSERT INTO nodes (name, state, since_ms, why) SELECT printf('sim-%06d', c - 1), 'offline', 0, '' FROM k")
db.execute("INSERT INTO cameras (node_id, name) SELECT id, 'front' FROM nodes ORDER BY id")
db.execute(COUNTING.format(40) + """INSERT INTO setups (policy, threshold, value, model, provider, power_source, total_from)
    SELECT 'albireo', 'u', c / 100000.0, 'detector.onnx', 'cuda', 'ina3221', 'input_rail' FROM k""")
columns = [row[1] for row in db.execute("PRAGMA table_info(clips)")]
today = int(time.time()) // 86400
for day in range(today - days, today):
    first = (day - today + days) * clips
    db.execute(f"""INSERT INTO clips ({', '.join(columns)})
        {COUNTING.format(nodes)}, d(n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM d WHERE n < {clips - 1}),
        x AS MATERIALIZED (SELECT c, n + {first} AS n, abs(random() % 1000000) AS r,
            {day} * {DAY_MS} + (c * 7919 % (2161 - {clips}) + n) * 40000 + c % 40000 AS at_ms FROM d, k)
        SELECT {', '.join(VALUES[column] for column in columns)} FROM x""")
    print(f"day {day - today + days + 1} of {days}", file=sys.stderr)
db.execute("INSERT INTO report_ids (day, id) SELECT day, report_id FROM clips ORDER BY 1, 2")
for table, seconds in (("sums_5m", 300), ("sums_hour", 3600)):
    add = re.sub(r"\$(\d)", r"?\1", f"INSERT INTO {table}" + read("sql/add_sums.sql"))
    db.execute(add, (0, seconds, 1 << 62))
made = nodes * days * clips
now_ms = int(time.time() * 1000)
db.execute("""INSERT INTO report_counts (node_id, first_ms, last_ms, stored, highest)
    SELECT id, ?, ?, ?, ? FROM nodes""", (now_ms - days * DAY_MS, now_ms, days * clips, days * clips))
db.commit()
tables = ("clips", "clips_by_camera", "report_ids", "sums_5m", "sums_hour")
for name, size in db.execute("SELECT name, sum(pgsize) FROM dbstat GROUP BY 1 ORDER BY 2 DESC"):
    if name in tables:
        print(f"{name:<16} {size / made:6.1f} bytes a clip")
print(f"{made} clips, {os.path.getsize(file) / 1e6:.0f} MB, {os.path.getsize(file) / nodes / 1e6:.2f} MB a camera")

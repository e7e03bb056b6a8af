"""Writes the decisions that policies make through the package, for the bit-exact comparison with the core in a test.

Usage: golden.py JOBS OUT. Each line of JOBS is a recording under a policy: {"name", "policy", "threshold", "size",
"empty_without_detections", "frames": [[[x1, y1, x2, y2, confidence, class], …], …]}. OUT/NAME gets, for each frame, numbers
of 64 bits: state, largest uncertainty or -1, active objects, and the number of boxes; of each box its corners, confidence,
class, id and source; then the number of objects and of each what is remembered.
"""

import json
import pathlib
import sys
import time
from array import array

import numpy as np

from albireo import Skipper
from albireo._core import SOURCES

STATES = ["E", "P", "E+I", "I", "AI"]

out = pathlib.Path(sys.argv[2])
spent = 0.0
frames = 0
for line in open(sys.argv[1]):
    job = json.loads(line)
    skip = Skipper(job["policy"], threshold=job["threshold"], size=job["size"], profile="reference")
    numbers = array("d")
    for n, found in enumerate(job["frames"]):
        found = np.array(found, float).reshape(-1, 6)
        empty = job["empty_without_detections"] and not len(found)
        start = time.perf_counter()
        if skip.wants_detector(n, empty=empty):
            boxes = skip.update((found[:, :4], found[:, 4], found[:, 5]))
        else:
            boxes = skip.predict()
        spent += time.perf_counter() - start
        frames += 1
        core = skip._core
        tau = -1.0 if core.tau_max is None else core.tau_max
        numbers.extend([STATES.index(skip.state), tau, core.active, len(boxes.xyxy)])
        sources = [SOURCES.index(source) for source in boxes.source]
        for corners, *columns in zip(boxes.xyxy.tolist(), boxes.confidence, boxes.class_id, boxes.tracker_id, sources):
            numbers.extend([*corners, *columns])
        objects = core.objects()
        numbers.append(len(objects))
        for record in objects:
            numbers.extend([*record[:4], *record[4], *record[5:]])
    (out / job["name"]).write_bytes(numbers.tobytes())
print(f"{frames} frames, {1e6 * spent / frames:.1f} µs a frame")

"""Microseconds a frame at 30 moving objects, beside other trackers where they are installed.

`make peers` sets up an environment that has the others (.cache/vendors). Each gets the detector's boxes on every frame, as its own
documentation says; the time is that of its call and of the conversion to its own type of detections.
"""

import statistics
import time
import warnings

import numpy as np

import albireo

warnings.simplefilter("ignore")
SIZE = (1280, 720)
OBJECTS = 30
FRAMES = 600
ROUNDS = 5
random = np.random.default_rng(0)
START = random.uniform((0, 0), (900, 650), (OBJECTS, 2))
SPEED = random.uniform(-0.5, 0.5, (OBJECTS, 2))


def detections(n):
    corner = START + n * SPEED + random.normal(0, 0.5, (OBJECTS, 2))
    return np.hstack([corner, corner + 60]), np.full(OBJECTS, 0.9), np.zeros(OBJECTS, int)


FOUND = [detections(n) for n in range(FRAMES)]


def skipper(policy, convert=lambda *found: found):
    skip = albireo.Skipper(policy, size=SIZE)
    found = [convert(*one) for one in FOUND]

    def frame(n):
        return skip.update(found[n]) if skip.wants_detector(n) else skip.predict()

    return frame


def norfair():
    import norfair

    tracker = norfair.Tracker(distance_function="iou", distance_threshold=0.7)

    def frame(n):
        xyxy, confidence, _ = FOUND[n]
        boxes = [norfair.Detection(box.reshape(2, 2), np.full(2, score)) for box, score in zip(xyxy, confidence)]
        return tracker.update(detections=boxes)

    return frame


def supervised(*found):
    import supervision

    return supervision.Detections(*found[:1], confidence=found[1], class_id=found[2])


def trackers(name):
    import trackers

    tracker = getattr(trackers, name)()
    found = [supervised(*one) for one in FOUND]
    return lambda n: tracker.update(found[n])


def trackforge(name):
    import trackforge

    tracker = getattr(trackforge, name)()

    def frame(n):
        xyxy, confidence, class_id = (column.tolist() for column in FOUND[n])
        boxes = [([left, top, right - left, bottom - top], score, kind)
                 for (left, top, right, bottom), score, kind in zip(xyxy, confidence, class_id)]
        return tracker.update(boxes)

    return frame


CANDIDATES = {
    "albireo vanilla, arrays (nearly all of it the way in and out)": lambda: skipper("vanilla"),
    "albireo, arrays": lambda: skipper("albireo"),
    "albireo expected-loss, arrays": lambda: skipper("expected-loss"),
    "albireo expected-loss, supervision": lambda: skipper("expected-loss", supervised),
    "norfair": norfair,
    "trackers SORT": lambda: trackers("SORTTracker"),
    "trackers ByteTrack": lambda: trackers("ByteTrackTracker"),
    "trackforge SORT": lambda: trackforge("SORT"),
    "trackforge ByteTrack": lambda: trackforge("BYTETRACK"),
}

for name, make in CANDIDATES.items():
    spent = []
    try:
        for _ in range(ROUNDS):
            frame = make()
            start = time.perf_counter()
            for n in range(FRAMES):
                frame(n)
            spent.append(1e6 * (time.perf_counter() - start) / FRAMES)
    except (ImportError, AttributeError) as error:
        print(f"{name}: left out ({error})")
        continue
    print(f"{name}: {statistics.median(spent):.1f} µs a frame")

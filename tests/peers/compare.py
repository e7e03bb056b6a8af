"""Compares other trackers with albireo on the recorded sequences with ground truth, at equal detector calls; see `make peers`.

Each tracker gets the stored detections of every n-th frame and is used as its documentation describes. If that describes no
way to skip a frame, the boxes of the last call are kept. Writes the tables between the marks in EVALUATION.md.
"""

import argparse
import csv
import json
import logging
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
import warnings

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/python"))
import boxmot  # noqa: E402
import edgefirst.tracker  # noqa: E402
import norfair  # noqa: E402
import supervision  # noqa: E402
import trackers  # noqa: E402
import trackforge  # noqa: E402
from tracking_scores import judge as identities  # noqa: E402

import albireo  # noqa: E402

warnings.simplefilter("ignore")
logging.disable(logging.INFO)
SHOWN = 0.3  # as in crates/eval: HOTA, IDF1 and F1 are of boxes of this confidence and above
EVERY = [1, 2, 3, 5]
ROUNDS = 3
FIGURES = ["AP@50", "AP@75", "F1@50", "HOTA", "IDF1"]
NOTHING = np.empty((0, 4)), np.empty(0), np.empty(0, int)


class Sequence:
    def __init__(self, folder, entry, confidence):
        rows = {
            kind: read(folder / kind / f"{entry['name']}.csv", entry["frames"])
            for kind in ("detections", "groundtruth", "ignore")
        }
        self.name, self.fps, self.size = entry["name"], entry["fps"], (entry["width"], entry["height"])
        self.found = [
            (boxes[:, :4], boxes[:, 4], boxes[:, 5].astype(int))
            for boxes in (frame[frame[:, 4] >= confidence] for frame in rows["detections"])
        ]
        self.truth = [frame[:, :4] for frame in rows["groundtruth"]]
        self.objects = [[[int(row[5]), *row[:4]] for row in frame.tolist()] for frame in rows["groundtruth"]]
        self.ignored = [frame[:, :4] for frame in rows["ignore"]]


def read(path, frames):
    """Reads the columns after the frame number, as one array per frame."""
    rows = list(csv.reader(path.open()))[1:] if path.exists() else []
    by_frame = [[] for _ in range(frames)]
    for row in rows:
        by_frame[int(row[0])].append([float(cell) for cell in row[1:]])
    return [np.array(frame, float).reshape(-1, len(rows[0]) - 1 if rows else 4) for frame in by_frame]


def areas(boxes):
    return (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])


def overlaps(a, b):
    """Returns the area of the intersection of each of `a` with each of `b`."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    return np.clip(np.minimum(a[:, None, 2:], b[None, :, 2:]) - low, 0, None).prod(2)


def iou(a, b):
    both = overlaps(a, b)
    return both / (areas(a)[:, None] + areas(b)[None] - both)


def judge(sequence, shown):
    """Returns the FIGURES of boxes by the definitions of `albireo eval` (crates/eval/src/average_precision.rs)."""
    confidences, hits, tracks = [], {0.5: [], 0.75: []}, []
    for (boxes, confidence, ids), truth, ignored in zip(shown, sequence.truth, sequence.ignored, strict=True):
        near = iou(boxes, truth)
        inside = (2 * overlaps(boxes, ignored) >= areas(boxes)[:, None]).any(1)
        judged = ~inside | (near >= 0.5).any(1)
        boxes, confidence, ids, near = boxes[judged], confidence[judged], ids[judged], near[judged]
        counted = (confidence >= SHOWN) & (ids >= 0)
        tracks.append([[one, *box] for one, box in zip(ids[counted].tolist(), boxes[counted].tolist())])
        order = np.argsort(-confidence, kind="stable")
        confidences.extend(confidence[order])
        for threshold, found in hits.items():
            free = np.ones(len(truth), bool)
            for row in near[order]:
                row = np.where(free & (row >= threshold), row, 0)
                best = int(row.argmax()) if len(row) else 0
                hit = bool(len(row)) and row[best] > 0
                found.append(hit)
                if hit:
                    free[best] = False
    truths = sum(map(len, sequence.truth))
    confidences = np.array(confidences)
    ranked = np.argsort(-confidences, kind="stable")
    areas_under = []
    for found in hits.values():
        found = np.array(found, bool)[ranked]
        precision = (np.cumsum(found) / np.arange(1, len(found) + 1))[found]
        areas_under.append(np.maximum.accumulate(precision[::-1]).sum() / truths)
    faint = confidences < SHOWN
    f1 = 2 * (np.array(hits[0.5], bool) & ~faint).sum() / ((~faint).sum() + truths)
    return [*areas_under, f1, *identities(sequence.objects, tracks)]


# A tracker maps a sequence and n to a function of a frame's number and detections, which are None if the detector is skipped.
# That function returns boxes, confidences and ids (-1: a box without a track), or None to keep the boxes of the last call.


def detector(sequence, every):
    return lambda n, found: found and (*found[:2], np.full(len(found[1]), -1))


def with_norfair(sequence, every):
    # The distance and threshold of Norfair's demonstrations with boxes.
    tracker = norfair.Tracker(distance_function="iou", distance_threshold=0.7)

    def frame(n, found):
        if found is None:
            tracked = tracker.update()
        else:
            detections = [
                norfair.Detection(box.reshape(2, 2), np.full(2, confidence), label=kind)
                for box, confidence, kind in zip(*found)
            ]
            tracked = tracker.update(detections, period=every)
        if not tracked:
            return NOTHING
        boxes = np.array([one.estimate.reshape(4) for one in tracked])
        return boxes, np.array([one.last_detection.scores[0] for one in tracked]), np.array([one.id for one in tracked])

    return frame


def with_trackers(name):
    def make(sequence, every):
        tracker = getattr(trackers, name)(frame_rate=sequence.fps)

        def frame(n, found):
            if found is None:
                return None
            boxes, confidence, kind = found
            detections = supervision.Detections(boxes, confidence=confidence, class_id=kind)
            tracked = tracker.update(detections, timestamp=n / sequence.fps)
            if not len(tracked):
                return NOTHING
            return tracked.xyxy, tracked.confidence, tracked.tracker_id

        return frame

    return make


def with_trackforge(name):
    def make(sequence, every):
        tracker = getattr(trackforge, name)()

        def frame(n, found):
            if found is None:
                return None
            rows = zip(*(column.tolist() for column in found))
            boxes = [([x1, y1, x2 - x1, y2 - y1], confidence, kind) for (x1, y1, x2, y2), confidence, kind in rows]
            tracked = tracker.update(boxes)
            if not tracked:
                return NOTHING
            x, y, width, height = np.array([one[1] for one in tracked]).T
            corners = np.stack([x, y, x + width, y + height], 1)
            return corners, np.array([one[2] for one in tracked]), np.array([one[0] for one in tracked])

        return frame

    return make


def with_boxmot(name):
    # Only trackers that need just the size of a picture, because the recordings have no pixels.
    def make(sequence, every):
        tracker = getattr(boxmot, name)()
        width, height = sequence.size
        picture = np.zeros((height, width, 3), np.uint8)

        def frame(n, found):
            if found is None:
                return None
            tracked = tracker.update(np.column_stack(found), picture)
            if not len(tracked):
                return NOTHING
            return tracked[:, :4], tracked[:, 5], tracked[:, 4].astype(int)

        return frame

    return make


def with_edgefirst(sequence, every):
    tracker = edgefirst.tracker.ByteTrack()
    size = np.array(2 * sequence.size, float)
    numbers = {}

    def frame(n, found):
        if found is None:
            return None
        boxes, confidence, kind = found
        scaled = (boxes / size).astype(np.float32)
        tracked = tracker.update(scaled, confidence.astype(np.float32), kind.astype(np.uintp), int(n / sequence.fps * 1e9))
        # Its predicted boxes lag far behind (AP@75 .07 on every frame), so only its ids are used, with the detections' boxes.
        ids = [numbers.setdefault(one.uuid, len(numbers)) if one else -1 for one in tracked]
        return boxes, confidence, np.array(ids, int)

    return frame


PEERS = {
    "the detector, boxes kept": detector,
    "norfair": with_norfair,
    "trackers SORT": with_trackers("SORTTracker"),
    "trackers ByteTrack": with_trackers("ByteTrackTracker"),
    "trackers OC-SORT": with_trackers("OCSORTTracker"),
    "trackers C-BIoU": with_trackers("CBIoUTracker"),
    "BoxMOT ByteTrack": with_boxmot("ByteTrack"),
    "BoxMOT OC-SORT": with_boxmot("OcSort"),
    "BoxMOT SFSORT": with_boxmot("SFSORT"),
    "edgefirst-tracker": with_edgefirst,
    "trackforge SORT": with_trackforge("SORT"),
    "trackforge ByteTrack": with_trackforge("BYTETRACK"),
    "trackforge OC-SORT": with_trackforge("OCSORT"),
    "trackforge TrackTrack": with_trackforge("TRACKTRACK"),
}


def run_peer(make, sequence, every):
    """Returns the boxes of every frame, the seconds and the detector calls."""
    frame, shown, spent, last = make(sequence, every), [], 0.0, NOTHING
    for n, found in enumerate(sequence.found):
        start = time.perf_counter()
        boxes = frame(n, None if n % every else found)
        spent += time.perf_counter() - start
        last = last if boxes is None else boxes
        shown.append(last)
    return shown, spent, -(-len(shown) // every)


def run_albireo(threshold, sequence, policy="expected-loss", settle=False):
    """Does the same with albireo's package; with `settle`, boxes are interpolated between two calls."""
    skip = albireo.Skipper(policy, threshold=threshold, size=sequence.size, settle=settle)
    shown, settled, spent, calls = [], [], 0.0, 0
    for n, found in enumerate(sequence.found):
        start = time.perf_counter()
        if skip.wants_detector(n):
            calls += 1
            boxes = skip.update(found)
        else:
            boxes = skip.predict()
        if settle:
            settled += skip.settled()
        spent += time.perf_counter() - start
        shown.append(boxes)
    if settle:
        shown = [boxes for _, boxes in settled + skip.settled(end=True)]
    return [(boxes.xyxy, boxes.confidence, boxes.tracker_id) for boxes in shown], spent, calls


def skipped(sequences, threshold):
    return statistics.mean(1 - run_albireo(threshold, one)[2] / len(one.found) for one in sequences)


def threshold_for(sequences, every):
    """Returns the lowest threshold, in thousandths, that skips as many frames as a detector on every n-th frame."""
    wanted = statistics.mean(1 - -(-len(one.found) // every) / len(one.found) for one in sequences)
    low, high = 0, 8000
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if skipped(sequences, middle / 1000) >= wanted else (middle + 1, high)
    return low / 1000


def measure(sequences, run):
    """Returns the skipped share, the FIGURES and the microseconds per frame of `run` over all sequences."""
    rounds = [[run(one) for one in sequences] for _ in range(ROUNDS)]
    frames = sum(len(one.found) for one in sequences)
    micros = statistics.median(1e6 * sum(spent for _, spent, _ in one) / frames for one in rounds)
    figures = [judge(one, shown) for one, (shown, _, _) in zip(sequences, rounds[0])]
    share = statistics.mean(1 - calls / len(one.found) for one, (_, _, calls) in zip(sequences, rounds[0]))
    return share, figures, micros


def check(binary, folder, confidence, threshold, sequences, figures):
    """Checks that `albireo eval` finds the same figures for each sequence."""
    with tempfile.TemporaryDirectory() as out:
        command = [binary, "eval", "recorded", folder, "--confidence", str(confidence), "--out", out]
        command += ["--policy", f"expected-loss:{threshold}"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        rows = list(csv.DictReader(open(pathlib.Path(out) / "summary.csv")))
    theirs = {row["sequence"]: row for row in rows if row["policy"].startswith("expected-loss")}
    for sequence, ours in zip(sequences, figures):
        row = theirs[sequence.name]
        for name, value in zip(["ap50", "ap75", "f1_50_shown", "hota", "idf1"], ours):
            assert abs(float(row[f"{name}_all"]) - value) < 1e-9, (sequence.name, threshold, name, row[name], value)
    print(f"albireo eval finds the same for expected-loss at {threshold} on {len(sequences)} sequences", flush=True)


def table(sequences, every, folder, confidence, binary):
    threshold = 0.0 if every == 1 else threshold_for(sequences, every)
    rows = {}
    for name, make in PEERS.items():
        rows[name] = measure(sequences, lambda one: run_peer(make, one, every))
    if every > 1:
        run = lambda one: run_albireo(every, one, "fixed-skip-in-tracker")  # noqa: E731
        rows["**albireo**, the same frames"] = measure(sequences, run)
    rows[f"**albireo**, threshold {threshold}"] = measure(sequences, lambda one: run_albireo(threshold, one))
    check(binary, folder, confidence, threshold, sequences, list(rows.values())[-1][1])
    rows["**albireo**, settled"] = measure(sequences, lambda one: run_albireo(threshold, one, settle=True))
    lines = [f"| skipped | tracker | {' | '.join(FIGURES)} | µs a frame |", "|" + " --- |" * (len(FIGURES) + 3)]
    for name, (share, figures, micros) in rows.items():
        # The detector alone has no ids.
        cells = [f"{value:.3f}" if value else "" for value in np.mean(figures, 0)]
        lines.append(f"| {share:.2f} | {name} | {' | '.join(cells)} | {micros:.0f} |")
        print(lines[-1], flush=True)
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shared", type=pathlib.Path, required=True)
    parser.add_argument("--albireo", default=ROOT / "target/debug/albireo", help="the program, which must agree")
    parser.add_argument("--confidence", type=float, default=0.5, help="detections below this are not given to anybody")
    parser.add_argument("--every", type=int, nargs="+", default=EVERY, help="the detector runs on every n-th frame")
    parser.add_argument("--page", type=pathlib.Path, help="write the tables between its marks")
    asked = parser.parse_args()
    folder = asked.shared / "data/recorded"
    entries = json.loads((folder / "sequences.json").read_text())["sequences"]
    entries = [entry for entry in entries if (folder / "groundtruth" / f"{entry['name']}.csv").exists()]
    sequences = [Sequence(folder, entry, asked.confidence) for entry in entries]
    tables = [table(sequences, every, folder, asked.confidence, asked.albireo) for every in asked.every]
    lines = tables[0] + [line for rows in tables[1:] for line in rows[2:]]
    if asked.page:
        before, _, rest = asked.page.read_text().partition("<!-- peers -->")
        _, mark, after = rest.partition("<!-- /peers -->")
        assert mark, f"{asked.page} has no marks for the tables"
        asked.page.write_text("\n".join([before + "<!-- peers -->", *lines, mark + after]))


if __name__ == "__main__":
    main()

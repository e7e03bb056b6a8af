#!/usr/bin/env python3
"""What a pause on an empty road saves and costs on recorded detections, judged by the detector's own tracks.

usage: benches/empty_road.py FOLDER [CONFIDENCE] [-- POLICY ...]

FOLDER is what `albireo eval video ... --save-detections FOLDER` writes. Boxes of CONFIDENCE (0.5) and more are linked by
overlap, over gaps of half a second; tracks of five boxes and more are the ground truth, as a box that comes once is mostly
a false one. Each clip is also played without its first frames, because a pause depends on where it begins. Then `albireo
eval recorded` (ALBIREO names another program than `albireo` in PATH) runs the policies, and this prints for each: detector
calls as a share of frames, mean over clips; recall and delay over all boxes and newcomers; and both for the worst clip,
as a difference to the first policy.
"""

import collections
import csv
import dataclasses
import json
import os
import pathlib
import subprocess
import sys
import tempfile

STARTS = (0, 1, 2, 3, 4, 5, 7)
LEAST_BOXES = 5
LEAST_IOU = 0.3
GAP_S = 0.5
POLICIES = ["albireo"] + [
    f"albireo,pause_s={pause},after_s={after}"
    for pause, after in [(0.2, 1), (0.16, 0.5), (0.2, 0.3), (0.32, 0.5), (0.32, 0.3)]
]


def area(box):
    x1, y1, x2, y2 = box
    return (x2 - x1) * (y2 - y1)


def overlap(a, b):
    """The intersection over the union of two boxes (x1, y1, x2, y2)."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    shared = max(width, 0) * max(height, 0)
    return shared / (area(a) + area(b) - shared)


def tracks(rows, confidence, gap):
    """Links the rows (frame, x1, y1, x2, y2, score, class) of a clip; returns lists of (frame, box, class)."""
    frames = collections.defaultdict(list)
    for frame, x1, y1, x2, y2, score, kind in rows:
        if float(score) >= confidence:
            frames[int(frame)].append((tuple(map(float, (x1, y1, x2, y2))), kind))
    found = []
    live = []
    for frame in sorted(frames):
        live = [track for track in live if frame - track[-1][0] <= gap]
        pairs = []
        for i, track in enumerate(live):
            _, last_box, _ = track[-1]
            for j, (box, _) in enumerate(frames[frame]):
                pairs.append((overlap(last_box, box), i, j))
        pairs.sort(reverse=True)
        used = set()
        taken = set()
        for value, i, j in pairs:
            if value >= LEAST_IOU and i not in used and j not in taken:
                used.add(i)
                taken.add(j)
                live[i].append((frame, *frames[frame][j]))
        for j, one in enumerate(frames[frame]):
            if j not in taken:
                live.append([(frame, *one)])
                found.append(live[-1])
    return [track for track in found if len(track) >= LEAST_BOXES]


def write(folder, clip, start, header, rows):
    """Writes the rows of a clip from frame `start` on, counted from there; returns their number."""
    folder.mkdir(exist_ok=True)
    kept = [[int(row[0]) - start, *row[1:]] for row in rows if int(row[0]) >= start]
    with open(folder / f"{clip}~{start}.csv", "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *kept])
    return len(kept)


def prepare(source, target, confidence):
    entries = []
    for clip in json.loads((source / "sequences.json").read_text())["sequences"]:
        with open(source / "detections" / f"{clip['name']}.csv", newline="") as file:
            header, *rows = csv.reader(file)
        linked = tracks(rows, confidence, max(1, round(GAP_S * clip["fps"])))
        truth = sorted([frame, *box, kind, n] for n, track in enumerate(linked) for frame, box, kind in track)
        truth_header = "frame x1 y1 x2 y2 class object_id".split()
        for start in STARTS:
            write(target / "detections", clip["name"], start, header, rows)
            boxes = write(target / "groundtruth", clip["name"], start, truth_header, truth)
            own = {"name": f"{clip['name']}~{start}", "frames": clip["frames"] - start, "ground_truth_boxes": boxes}
            entries.append({**clip, **own})
    (target / "sequences.json").write_text(json.dumps({"sequences": entries}))


@dataclasses.dataclass
class Figures:
    """The sums over the rows of a clip."""

    frames: float = 0
    calls: float = 0
    boxes: float = 0
    found: float = 0
    newcomers: float = 0
    late_frames: float = 0


def number(row, name):
    return float(row[name] or 0)


def figures(rows):
    sums = Figures()
    for row in rows:
        boxes = number(row, "gt_boxes")
        newcomers = number(row, "newcomers")
        sums.frames += number(row, "frames")
        sums.calls += number(row, "detector_frames")
        sums.boxes += boxes
        sums.found += number(row, "recall") * boxes
        sums.newcomers += newcomers
        sums.late_frames += number(row, "newcomer_frames") * newcomers
    return sums


def main():
    arguments, _, policies = " ".join(sys.argv[1:]).partition("--")
    folder, *confidence = arguments.split()
    confidence = float(confidence[0]) if confidence else 0.5
    with tempfile.TemporaryDirectory() as work:
        work = pathlib.Path(work)
        prepare(pathlib.Path(folder), work, confidence)
        asked = [part for policy in policies.split() or POLICIES for part in ("--policy", policy)]
        command = [os.environ.get("ALBIREO", "albireo"), "eval", "recorded", work, "--confidence", str(confidence)]
        subprocess.run([*command, *asked, "--out", work / "out"], check=True, stdout=subprocess.DEVNULL)
        with open(work / "out" / "summary.csv", newline="") as file:
            clips = collections.defaultdict(lambda: collections.defaultdict(list))
            for row in csv.DictReader(file):
                clips[row["policy"].split("-erd")[0]][row["sequence"].rpartition("~")[0]].append(row)
    clips.pop("vanilla")
    first = {clip: figures(rows) for clip, rows in next(iter(clips.values())).items()}
    print(f"{'policy':40} {'calls':>6} {'recall':>7} {'worst':>6} {'late':>6} {'worst':>6}")
    for policy, by_clip in clips.items():
        by_clip = {clip: figures(rows) for clip, rows in by_clip.items()}
        calls = sum(clip.calls / clip.frames for clip in by_clip.values()) / len(by_clip)
        recall = sum(clip.found for clip in by_clip.values()) / sum(clip.boxes for clip in by_clip.values())
        delay = sum(clip.late_frames for clip in by_clip.values()) / sum(clip.newcomers for clip in by_clip.values())
        most_lost = max((first[name].found - clip.found) / clip.boxes for name, clip in by_clip.items() if clip.boxes)
        most_delay = max(
            (clip.late_frames - first[name].late_frames) / clip.newcomers for name, clip in by_clip.items() if clip.newcomers
        )
        print(f"{policy:40} {calls:6.3f} {100 * recall:6.1f}% {-100 * most_lost:+6.1f} {delay:6.2f} {most_delay:+6.2f}")


if __name__ == "__main__":
    main()

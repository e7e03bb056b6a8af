"""Computes HOTA and IDF1 of tracks with TrackEval.

Reads JSON from standard input: a list of clips, each {"truth": FRAMES, "tracks": FRAMES}; FRAMES has a list of
[object, x1, y1, x2, y2] per frame. Writes JSON: for each clip [HOTA, IDF1].
"""

import contextlib
import io
import json
import sys

import numpy

with contextlib.redirect_stdout(io.StringIO()):  # of data sets that it has no tools for
    from trackeval.datasets._base_dataset import _BaseDataset
    from trackeval.metrics import HOTA, Identity


def columns(frames, numbers):
    """Returns, for each frame, the objects (numbered from 0) and their corners."""
    for frame in frames:
        objects = [numbers.setdefault(row[0], len(numbers)) for row in frame]
        yield numpy.array(objects, int), numpy.array([row[1:] for row in frame], float).reshape(-1, 4)


def judge(truth, tracks):
    numbers = {}, {}
    there, shown = list(columns(truth, numbers[0])), list(columns(tracks, numbers[1]))
    overlaps = [
        _BaseDataset._calculate_box_ious(known[1], found[1], box_format="x0y0x1y1") for known, found in zip(there, shown)
    ]
    data = {
        "num_gt_ids": len(numbers[0]),
        "num_tracker_ids": len(numbers[1]),
        "num_gt_dets": sum(map(len, truth)),
        "num_tracker_dets": sum(map(len, tracks)),
        "gt_ids": [frame[0] for frame in there],
        "tracker_ids": [frame[0] for frame in shown],
        "similarity_scores": overlaps,
    }
    with contextlib.redirect_stdout(io.StringIO()):
        hota = HOTA().eval_sequence(data)["HOTA"]
        identity = Identity().eval_sequence(data)
    return float(numpy.mean(hota)), float(identity["IDF1"])


if __name__ == "__main__":
    json.dump([judge(clip["truth"], clip["tracks"]) for clip in json.load(sys.stdin)], sys.stdout)

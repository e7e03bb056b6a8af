"""Accuracy of the exported detector, measured through ONNX Runtime as the program runs it.

    python evaluate.py detector.onnx DIR
"""

import json
import sys

import numpy as np
import onnxruntime
import torch

from dataset import CLASSES, detector_arrays

CONFIDENCE = 0.5
SUPPRESSION = 0.45
LEAST_HEIGHT = 16.0


def session(path, threads=2):
    """An ONNX Runtime session on the CPU."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def check_export(module, path, size, decode=lambda raw: raw):
    """Fails unless ONNX Runtime and PyTorch agree on random pictures."""
    module.eval()
    picture = torch.rand(1, 3, size[1], size[0], generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        expected = decode(module(picture)).numpy()
    answer = session(path).run(None, {"picture": picture.numpy()})[0]
    difference = float(np.abs(answer - expected).max())
    print(f"export: largest difference to PyTorch {difference:.2e}")
    if not np.allclose(answer, expected, rtol=1e-3, atol=1e-3):
        raise SystemExit("the exported model does not answer as PyTorch does")


def iou(box, boxes):
    """Intersection over union of one box with many."""
    sides = np.minimum(box[2:4], boxes[:, 2:4]) - np.maximum(box[:2], boxes[:, :2])
    inside = sides.clip(0).prod(1)
    areas = (boxes[:, 2:4] - boxes[:, :2]).prod(1)
    return inside / ((box[2:4] - box[:2]).prod() + areas - inside + 1e-9)


def suppress(rows):
    """Non-maximum suppression within each class; rows are x1, y1, x2, y2, score, class."""
    kept = []
    for kind in np.unique(rows[:, 5]):
        left = rows[rows[:, 5] == kind]
        left = left[np.argsort(-left[:, 4])]
        while len(left):
            kept.append(left[0])
            left = left[1:][iou(left[0], left[1:]) <= SUPPRESSION]
    return np.array(kept).reshape(-1, 6)


def detect(network, picture, least=0.02):
    """Detections of one uint8 picture of the network's size."""
    planes = (picture.astype(np.float32) / 255).transpose(2, 0, 1)[None]
    answer = network.run(None, {"picture": np.ascontiguousarray(planes)})[0][0]
    scores, kinds = answer[:, 4:].max(1), answer[:, 4:].argmax(1)
    good = scores >= least
    rows = np.column_stack([answer[good, :4], scores[good], kinds[good]])
    return suppress(rows)


def average_precision(hits, total):
    """All-point interpolated AP of hits (score, right) and the number of objects."""
    if total == 0 or not hits:
        return float("nan") if total == 0 else 0.0
    hits = sorted(hits, key=lambda hit: -hit[0])
    right = np.cumsum([hit[1] for hit in hits])
    precision = right / np.arange(1, len(hits) + 1)
    recall = right / total
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(np.diff(np.concatenate([[0.0], recall])) * precision))


def match(found, truth, judged, with_class):
    """(score, right) of each detection that counts. One that only covers an object that need not be
    found does not count."""
    free = np.ones(len(truth), bool)
    hits = []
    for row in found[np.argsort(-found[:, 4])]:
        overlap = iou(row, truth) if len(truth) else np.zeros(0)
        if with_class:
            overlap = np.where(truth[:, 4] == row[5], overlap, 0)
        best = np.where(free & judged, overlap, 0)
        if len(best) and best.max() >= 0.5:
            free[best.argmax()] = False
            hits.append((row[4], True))
        elif not (len(overlap) and overlap[~judged].size and overlap[~judged].max() >= 0.5):
            hits.append((row[4], False))
    return hits


def report(path, pictures, boxes):
    """AP at IoU 0.5 by class, their mean, with classes pooled, and precision and recall at 0.5."""
    network = session(path)
    by_class, totals = [[] for _ in CLASSES], [0] * len(CLASSES)
    pooled, count, found_at, right_at = [], 0, 0, 0
    for picture, frame in zip(pictures, boxes):
        truth = frame[frame[:, 4] >= 0]
        judged = (truth[:, 5] == 0) & (truth[:, 6] >= LEAST_HEIGHT)
        found = detect(network, picture)
        pooled += match(found, truth, judged, False)
        sure = match(found[found[:, 4] >= CONFIDENCE], truth, judged, True)
        found_at, right_at = found_at + len(sure), right_at + sum(hit[1] for hit in sure)
        count += int(judged.sum())
        for kind in range(len(CLASSES)):
            same = truth[:, 4] == kind
            totals[kind] += int((judged & same).sum())
            by_class[kind] += match(found[found[:, 5] == kind], truth[same], judged[same], True)
    precisions = [average_precision(hits, total) for hits, total in zip(by_class, totals)]
    return {
        "frames": len(boxes),
        "objects": count,
        "ap50": {name: round(value, 3) for name, value in zip(CLASSES, precisions)},
        "objects by class": dict(zip(CLASSES, totals)),
        "mean ap50": round(float(np.nanmean(precisions)), 3),
        "pooled ap50": round(average_precision(pooled, count), 3),
        "precision at 0.5": round(right_at / max(found_at, 1), 3),
        "recall at 0.5": round(right_at / max(count, 1), 3),
    }


if __name__ == "__main__":
    print(json.dumps(report(sys.argv[1], *detector_arrays(sys.argv[2])), indent=1))

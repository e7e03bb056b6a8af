"""Trains the demonstration detector on folders written by `albireo synth` and exports it to ONNX.

    python train_detector.py --train DIR [DIR …] --held-out DIR --out detector.onnx
"""

import argparse
import copy
import json
import time

import numpy as np
import torch
from torch.nn import functional

from dataset import CLASSES, DETECTOR_SIZE, detector_arrays
from evaluate import check_export, report
from network import Detector, STRIDES, average, export_detector, parameters

# Largest side of a box, input pixels, that each stride learns; neighbours overlap.
REACH = ((0.0, 22.0), (14.0, 60.0), (40.0, 1e4))


def assign(cells, boxes):
    """Which box each cell answers for: [n, cells] index, -1 background, -2 not judged.

    A cell answers for a box when its stride fits the box's size and its centre is near the box's
    centre; where several fit, the smallest box wins.
    """
    corners, classes, ignored = boxes[..., :4], boxes[..., 4], boxes[..., 5] > 0
    x, y, stride = (cells[:, i] for i in range(3))
    low = torch.tensor([dict(zip(STRIDES, REACH))[int(s)][0] for s in stride.tolist()])
    high = torch.tensor([dict(zip(STRIDES, REACH))[int(s)][1] for s in stride.tolist()])
    sides = corners[..., 2:] - corners[..., :2]
    middle = (corners[..., 2:] + corners[..., :2]) / 2
    largest = sides.amax(-1, keepdim=True)
    near = ((x - middle[..., :1]).abs() <= torch.maximum(0.6 * stride, 0.18 * sides[..., :1])) & (
        (y - middle[..., 1:]).abs() <= torch.maximum(0.6 * stride, 0.18 * sides[..., 1:])
    )
    real = (classes >= 0)[..., None]
    positive = near & (largest >= low) & (largest < high) & real & ~ignored[..., None]
    area = torch.where(positive, (sides[..., :1] * sides[..., 1:]).expand_as(positive), 1e9)
    smallest, index = area.min(1)
    chosen = torch.where(smallest < 1e9, index, -1)
    # Cells on an object that need not be found are neither right nor wrong.
    over = (
        (x > corners[..., :1])
        & (x < corners[..., 2:3])
        & (y > corners[..., 1:2])
        & (y < corners[..., 3:4])
        & (real & ignored[..., None])
    ).any(1)
    return torch.where((chosen < 0) & over, -2, chosen)


def overlaps(a, b):
    """Intersection over union and its generalised form of matched boxes [m, 4]."""
    left_top, right_bottom = torch.maximum(a[:, :2], b[:, :2]), torch.minimum(a[:, 2:], b[:, 2:])
    inside = (right_bottom - left_top).clamp(min=0).prod(1)
    areas = [(box[:, 2:] - box[:, :2]).clamp(min=0).prod(1) for box in (a, b)]
    union = areas[0] + areas[1] - inside + 1e-6
    hull = (torch.maximum(a[:, 2:], b[:, 2:]) - torch.minimum(a[:, :2], b[:, :2])).prod(1) + 1e-6
    return inside / union, inside / union - (hull - union) / hull


def assign_all(cells, boxes):
    """`assign` for every frame, once, kept as small numbers."""
    parts = [assign(cells, torch.from_numpy(boxes[i : i + 64])) for i in range(0, len(boxes), 64)]
    return torch.cat([part.to(torch.int8) for part in parts])


def mirror(chosen):
    """The assignment of the mirrored picture."""
    columns, rows = DETECTOR_SIZE
    parts, start = [], 0
    for stride in STRIDES:
        count = rows // stride * (columns // stride)
        grid = chosen[:, start : start + count].view(-1, rows // stride, columns // stride)
        parts.append(grid.flip(2).reshape(-1, count))
        start += count
    return torch.cat(parts, 1)


def loss_of(detector, raw, boxes, chosen, class_weights):
    """Class and box loss of a batch, each per positive cell."""
    found, logits = detector.boxes(raw), raw[:, 4:].transpose(1, 2)
    frame, cell = torch.nonzero(chosen >= 0, as_tuple=True)
    target = boxes[frame, chosen[frame, cell].long()]
    overlap, generalised = overlaps(found[frame, cell], target[:, :4])
    kinds = target[:, 4].long()
    # The score a cell should give says how well its box fits, so that the better of two survives.
    wanted = torch.zeros_like(logits)
    wanted[frame, cell, kinds] = 0.5 + 0.5 * overlap.detach().clamp(0, 1)
    weight = (chosen != -2).float()[..., None].expand_as(logits).clone()
    weight[frame, cell, kinds] = class_weights[kinds]
    count = max(len(frame), 1)
    classes = functional.binary_cross_entropy_with_logits(logits, wanted, weight, reduction="sum") / count
    return classes, (1 - generalised).sum() / count


def batches(pictures, boxes, assigned, size, random):
    """Endless augmented batches: mirrored, brighter, darker, tinted."""
    order = np.array([], dtype=int)
    while True:
        if len(order) < size:
            order = np.concatenate([order, random.permutation(len(boxes))])
        chosen, order = order[:size], order[size:]
        batch = torch.from_numpy(np.stack([pictures(i) for i in chosen])).permute(0, 3, 1, 2)
        truth = torch.from_numpy(boxes[chosen]).clone()
        mirrored = torch.from_numpy(random.random(size) < 0.5)
        batch = torch.where(mirrored[:, None, None, None], batch.flip(3), batch)
        flipped = truth.clone()
        flipped[..., 0] = DETECTOR_SIZE[0] - truth[..., 2]
        flipped[..., 2] = DETECTOR_SIZE[0] - truth[..., 0]
        truth = torch.where(mirrored[:, None, None], flipped, truth)
        cells = assigned[chosen]
        cells = torch.where(mirrored[:, None], mirror(cells), cells)
        batch = batch.float() / 255
        gain = torch.from_numpy(random.uniform(0.75, 1.25, (size, 1, 1, 1)).astype(np.float32))
        tint = torch.from_numpy(random.uniform(0.93, 1.07, (size, 3, 1, 1)).astype(np.float32))
        batch = (batch * gain * tint).clamp(0, 1).contiguous(memory_format=torch.channels_last)
        yield batch, truth, cells


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--train", nargs="+", required=True)
    parser.add_argument("--held-out", required=True)
    parser.add_argument("--out", default="detector.onnx")
    parser.add_argument("--epochs", type=int, default=9)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=3e-3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--resume", help="weights (.pt) of an earlier run to begin with")
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(arguments.threads)
    random = np.random.default_rng(arguments.seed)

    folders = [detector_arrays(folder) for folder in arguments.train]
    starts = np.cumsum([0] + [len(boxes) for _, boxes in folders])
    boxes = np.concatenate([boxes for _, boxes in folders])

    def picture(index):
        folder = int(np.searchsorted(starts, index, "right")) - 1
        return folders[folder][0][index - starts[folder]]

    judged = boxes[(boxes[..., 4] >= 0) & (boxes[..., 5] == 0)]
    counts = np.bincount(judged[:, 4].astype(int), minlength=len(CLASSES))
    print("frames", len(boxes), "objects", dict(zip(CLASSES, counts.tolist())), flush=True)
    class_weights = torch.tensor((counts.max() / counts.clip(1)) ** 0.35, dtype=torch.float32)

    detector = Detector().to(memory_format=torch.channels_last)
    if arguments.resume:
        detector.load_state_dict(torch.load(arguments.resume, weights_only=True))
    smooth = copy.deepcopy(detector).eval()
    print("parameters", parameters(detector), flush=True)
    decayed = [p for p in detector.parameters() if p.ndim > 1]
    others = [p for p in detector.parameters() if p.ndim <= 1]
    optimiser = torch.optim.AdamW(
        [{"params": decayed, "weight_decay": 0.02}, {"params": others, "weight_decay": 0.0}],
        lr=arguments.rate,
    )
    steps = len(boxes) // arguments.batch * arguments.epochs
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, arguments.rate, total_steps=steps, pct_start=0.08, final_div_factor=50
    )
    source = batches(picture, boxes, assign_all(detector.cells, boxes), arguments.batch, random)
    started, sums = time.time(), np.zeros(2)
    for step in range(steps):
        batch, truth, cells = next(source)
        with torch.autocast("cpu", torch.bfloat16):
            raw = detector(batch)
        losses = loss_of(detector, raw.float(), truth, cells, class_weights)
        optimiser.zero_grad(set_to_none=True)
        (losses[0] + 2.5 * losses[1]).backward()
        torch.nn.utils.clip_grad_norm_(detector.parameters(), 10.0)
        optimiser.step()
        schedule.step()
        average(smooth, detector, step, most=0.998)
        sums += [float(losses[0].detach()), float(losses[1].detach())]
        if (step + 1) % 100 == 0:
            taken = time.time() - started
            print(f"step {step + 1}/{steps} class {sums[0] / 100:.3f} box {sums[1] / 100:.3f} {taken:.0f} s", flush=True)
            sums[:] = 0
        if step + 1 == steps or (step + 1) % 500 == 0:
            torch.save(smooth.state_dict(), arguments.out + ".pt")

    export_detector(copy.deepcopy(smooth).to(memory_format=torch.contiguous_format), arguments.out)
    check_export(smooth, arguments.out, DETECTOR_SIZE, smooth.decode)
    pictures, truth = detector_arrays(arguments.held_out)
    print(json.dumps(report(arguments.out, pictures, truth), indent=1))


if __name__ == "__main__":
    main()

"""Trains the empty-scene screen on folders written by `albireo synth` and exports it to ONNX.

    python train_screen.py --train DIR [DIR …] --held-out DIR --out screen.onnx
"""

import argparse
import copy
import json
import time

import numpy as np
import torch
from torch.nn import functional

from dataset import SCREEN_SIZE, label, read_lines, screen_arrays
from evaluate import check_export, session
from network import Screen, average, export_screen, parameters

# Missing an object is worse than waking the detector for nothing, so its loss counts more.
WEIGHT_OF_NON_EMPTY = 3.0


def report(path, folder):
    """What the exported screen says of unseen worlds."""
    network = session(path)
    pictures, labels, _ = screen_arrays(folder)
    tallest = np.array([tallest_object(line) for line in read_lines(folder) if label(line) >= 0])
    verdicts = []
    for picture in pictures:
        planes = (picture.astype(np.float32) / 255).transpose(2, 0, 1)[None]
        verdicts.append(network.run(None, {"picture": np.ascontiguousarray(planes)})[0][0].argmax())
    verdicts = np.array(verdicts)
    empty, busy, plain = labels == 0, labels == 1, tallest >= 32.0
    return {
        "frames": len(labels),
        "empty": int(empty.sum()),
        "false-empty rate": round(float((verdicts[busy] == 0).mean()), 4),
        "frames with an object of 32 rows or more": int(plain.sum()),
        "false-empty rate among them": round(float((verdicts[plain] == 0).mean()), 4),
        "false-non-empty rate": round(float((verdicts[empty] == 1).mean()), 4),
    }


def tallest_object(line):
    """Height at 720 rows of the tallest object that must be found; 0 without one."""
    heights = [found["y2"] - found["y1"] for found in line["objects"] if not found["ignore"]]
    return max(heights, default=0.0) * 720.0 / line["height"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--train", nargs="+", required=True)
    parser.add_argument("--held-out", required=True)
    parser.add_argument("--out", default="screen.onnx")
    parser.add_argument("--every", type=int, default=1, help="use every n-th training picture")
    parser.add_argument("--epochs", type=int, default=6)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=4e-3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--resume", help="weights (.pt) of an earlier run to begin with")
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(arguments.threads)
    random = np.random.default_rng(arguments.seed)

    folders = [screen_arrays(folder, arguments.every) for folder in arguments.train]
    starts = np.cumsum([0] + [len(labels) for _, labels, _ in folders])
    labels = np.concatenate([labels for _, labels, _ in folders])
    maps = np.concatenate([maps for _, _, maps in folders])
    print("frames", len(labels), "empty", int((labels == 0).sum()), flush=True)

    def picture(index):
        folder = int(np.searchsorted(starts, index, "right")) - 1
        return folders[folder][0][index - starts[folder]]

    screen = Screen().to(memory_format=torch.channels_last)
    if arguments.resume:
        screen.load_state_dict(torch.load(arguments.resume, weights_only=True))
    smooth = copy.deepcopy(screen).eval()
    print("parameters", parameters(screen) - parameters(screen.places), flush=True)
    optimiser = torch.optim.AdamW(screen.parameters(), lr=arguments.rate, weight_decay=0.02)
    steps = len(labels) // arguments.batch * arguments.epochs
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, arguments.rate, total_steps=steps, pct_start=0.1)
    weights = torch.tensor([1.0, WEIGHT_OF_NON_EMPTY])
    started, total, order = time.time(), 0.0, np.array([], dtype=int)
    for step in range(steps):
        if len(order) < arguments.batch:
            order = np.concatenate([order, random.permutation(len(labels))])
        chosen, order = order[: arguments.batch], order[arguments.batch :]
        batch = torch.from_numpy(np.stack([picture(i) for i in chosen])).permute(0, 3, 1, 2)
        mirrored = torch.from_numpy(random.random(len(chosen)) < 0.5)[:, None, None, None]
        batch = torch.where(mirrored, batch.flip(3), batch).to(torch.bfloat16)
        cells = torch.from_numpy(maps[chosen])
        cells = torch.where(mirrored[:, 0], cells.flip(2), cells)
        gain = torch.from_numpy(random.uniform(0.75, 1.25, (len(chosen), 1, 1, 1)) / 255)
        batch = (batch * gain.to(torch.bfloat16)).clamp(0, 1)
        with torch.autocast("cpu", torch.bfloat16):
            features = screen.blocks(batch.contiguous(memory_format=torch.channels_last))
            logits, places = screen.classify(features), screen.places(features)
        loss = functional.cross_entropy(logits.float(), torch.from_numpy(labels[chosen]), weights)
        # Told where the objects are, the network finds out much faster what they look like.
        loss = loss + 0.5 * functional.binary_cross_entropy_with_logits(
            places[:, 0].float(), (cells > 0).float(), (cells >= 0).float(), reduction="sum"
        ) / (cells > 0).sum().clamp(min=1)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        schedule.step()
        average(smooth, screen, step, most=0.99)
        total += float(loss.detach())
        if (step + 1) % 50 == 0:
            print(f"step {step + 1}/{steps} loss {total / 50:.3f} {time.time() - started:.0f} s", flush=True)
            total = 0.0

    torch.save(smooth.state_dict(), arguments.out + ".pt")
    export_screen(copy.deepcopy(smooth).to(memory_format=torch.contiguous_format), arguments.out)
    check_export(smooth, arguments.out, SCREEN_SIZE)
    print(json.dumps(report(arguments.out, arguments.held_out), indent=1))


if __name__ == "__main__":
    main()

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

from dataset import SCREEN_SIZE, screen_arrays
from evaluate import check_export, session
from network import Screen, export_screen, parameters

# Missing an object is worse than waking the detector for nothing, so its loss counts more.
WEIGHT_OF_NON_EMPTY = 3.0


def report(path, pictures, labels):
    """What the exported screen says of unseen worlds."""
    network = session(path)
    verdicts = []
    for picture in pictures:
        planes = (picture.astype(np.float32) / 255).transpose(2, 0, 1)[None]
        verdicts.append(network.run(None, {"picture": np.ascontiguousarray(planes)})[0][0].argmax())
    verdicts = np.array(verdicts)
    empty, busy = labels == 0, labels == 1
    return {
        "frames": len(labels),
        "empty": int(empty.sum()),
        "false-empty rate": round(float((verdicts[busy] == 0).mean()), 4),
        "false-non-empty rate": round(float((verdicts[empty] == 1).mean()), 4),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--train", nargs="+", required=True)
    parser.add_argument("--held-out", required=True)
    parser.add_argument("--out", default="screen.onnx")
    parser.add_argument("--every", type=int, default=2, help="use every n-th training picture")
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=4e-3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(arguments.threads)
    random = np.random.default_rng(arguments.seed)

    folders = [screen_arrays(folder, arguments.every) for folder in arguments.train]
    starts = np.cumsum([0] + [len(labels) for _, labels in folders])
    labels = np.concatenate([labels for _, labels in folders])
    print("frames", len(labels), "empty", int((labels == 0).sum()), flush=True)

    def picture(index):
        folder = int(np.searchsorted(starts, index, "right")) - 1
        return folders[folder][0][index - starts[folder]]

    screen = Screen().to(memory_format=torch.channels_last)
    smooth = copy.deepcopy(screen).eval()
    print("parameters", parameters(screen), flush=True)
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
        batch = torch.where(mirrored, batch.flip(3), batch).float() / 255
        gain = torch.from_numpy(random.uniform(0.75, 1.25, (len(chosen), 1, 1, 1)).astype(np.float32))
        batch = (batch * gain).clamp(0, 1).contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", torch.bfloat16):
            logits = screen(batch)
        loss = functional.cross_entropy(logits.float(), torch.from_numpy(labels[chosen]), weights)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        schedule.step()
        keep = min(0.99, (1 + step) / (10 + step))
        with torch.no_grad():
            for slow, fast in zip(smooth.state_dict().values(), screen.state_dict().values()):
                if slow.dtype.is_floating_point:
                    slow.lerp_(fast, 1 - keep)
                else:
                    slow.copy_(fast)
        total += float(loss.detach())
        if (step + 1) % 50 == 0:
            print(f"step {step + 1}/{steps} loss {total / 50:.3f} {time.time() - started:.0f} s", flush=True)
            total = 0.0

    export_screen(copy.deepcopy(smooth).to(memory_format=torch.contiguous_format), arguments.out)
    check_export(smooth, arguments.out, SCREEN_SIZE)
    print(json.dumps(report(arguments.out, *screen_arrays(arguments.held_out)), indent=1))


if __name__ == "__main__":
    main()

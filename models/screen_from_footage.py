"""Trains an empty-scene screen on your own footage, with your own detector as the teacher.

    python screen_from_footage.py --videos drive/*.mp4 --detector yolo11n.onnx --out screen.onnx
    python screen_from_footage.py --videos bdd100k/images/track/train --detector yolo26x.onnx --out screen.onnx

A clip is a video or a folder of pictures; a folder of such folders is a data set.
Each frame in which the detector finds something at --confidence is "occupied", every other one "empty" (paper,
section on the empty-road classifier). Whole clips are kept for validation, never frames of a clip that was
trained on; the figure to look at is the false-empty rate there: how many occupied frames would be skipped.
Needs `albireo` and `ffmpeg` on the path and the packages of requirements.txt; no GPU.
"""

import argparse
import copy
import csv
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional
from tqdm import tqdm

from screen_network import SCREEN_SIZE, Screen, average, export_screen, load_screen, session

EMPTY, OCCUPIED = 0, 1


def store_detections(arguments, folder):
    """Has albireo run the detector once over all videos and keep what it found."""
    command = ["albireo", "eval", "video", *arguments.videos, "--detector", arguments.detector]
    command += ["--head", arguments.head, "--policy", "vanilla", "--save-detections", str(folder)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def labels_of(folder, name, frames, confidence):
    """One label a frame, from the detections that `albireo eval … --save-detections` has written."""
    labels = np.full(frames, EMPTY)
    stored = Path(folder) / "detections" / f"{name}.csv"
    if not stored.is_file():
        sys.exit(f"{stored}: no such file: were the detections stored for other clips?")
    with open(stored, encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            frame = int(row["frame"])
            if frame < frames and float(row["score"]) >= confidence:
                labels[frame] = OCCUPIED
    return labels


def pictures_in(folder):
    """The pictures of a folder in albireo's order: by name, numbers by value."""
    kinds = (".jpg", ".jpeg", ".png")
    files = [file for file in folder.iterdir() if file.suffix.lower() in kinds and file.is_file()]
    padded = [re.sub(r"\d+", lambda digits: digits[0].lstrip("0").rjust(20, "0"), file.name) for file in files]
    return [file for _, file in sorted(zip(padded, files))]


def clips_of(path):
    """The videos and folders of pictures that albireo takes `path` for."""
    if not path.is_dir() or pictures_in(path):
        return [path]
    folders = [folder / "img1" if (folder / "img1").is_dir() else folder for folder in sorted(path.iterdir()) if folder.is_dir()]
    clips = [folder for folder in folders if pictures_in(folder)]
    return clips or sys.exit(f"{path}: no folder of pictures in it; give videos by their names, such as {path}/*.mp4")


def name_of(clip):
    """The clip's name in albireo's files."""
    own = clip.parent.name if clip.name == "img1" else clip.stem
    return re.sub(r"[^A-Za-z0-9_.-]", "_", own.lstrip(".")[:100]) or "clip"


def pictures_of(clip, every, folder):
    """Every n-th frame, scaled to the screen's input: [n, rows, columns, 3] uint8, RGB. They stay in a file in `folder`, as
    those of a data set are more than fits into memory."""
    columns, rows = SCREEN_SIZE
    source, files = ["-i", str(clip)], None
    if clip.is_dir():
        files = pictures_in(clip)
        listed = Path(folder) / "pictures.txt"
        quoted = [str(file.resolve()).replace("'", "'\\''") for file in files]
        listed.write_text("".join(f"file '{file}'\n" for file in quoted), encoding="utf-8")
        source = ["-f", "concat", "-safe", "0", "-i", str(listed)]
    raw = Path(folder) / f"{name_of(clip)}.rgb"
    if raw.exists():
        sys.exit(f"{clip}: a clip before it is named {name_of(clip)}, too: rename one")
    chosen = f"select=not(mod(n\\,{every})),scale={columns}:{rows}:flags=bilinear"
    command = ["ffmpeg", "-nostdin", "-loglevel", "error", *source, "-vf", chosen, "-fps_mode", "passthrough"]
    subprocess.run([*command, "-pix_fmt", "rgb24", "-f", "rawvideo", str(raw)], check=True)
    size = raw.stat().st_size
    count = size // (rows * columns * 3)
    if count == 0 or (files and count != -(-len(files) // every)):
        sys.exit(f"{clip}: ffmpeg read {count} of its pictures: are all of one kind, JPEG or PNG, and whole?")
    return np.memmap(raw, np.uint8, "r", shape=(count, rows, columns, 3))


def split_by_clip(clips, share):
    """Clips to train on and to validate on, so that both kinds of frame are in both where that can be.

    The clips with the most frames of the rarer kind alternate, validation getting about `share` of the frames.
    """
    total = sum(len(labels) for _, _, labels in clips)
    rarest = [min((labels == EMPTY).sum(), (labels == OCCUPIED).sum()) for _, _, labels in clips]
    training, validation, kept = [], [], 0
    for place, index in enumerate(np.argsort(rarest)[::-1]):
        frames = len(clips[index][2])
        if place % 2 == 1 and kept + frames <= max(share * total, frames):
            validation.append(clips[index])
            kept += frames
        else:
            training.append(clips[index])
    return training, validation


def verdicts_of(path, clips):
    """Labels and verdicts of the exported screen, frame by frame."""
    network = session(path)
    labels, verdicts = [], []
    for _, pictures, of_clip in clips:
        for picture, label in zip(pictures, of_clip):
            planes = (picture.astype(np.float32) / 255).transpose(2, 0, 1)[None]
            logits = network.run(None, {"picture": np.ascontiguousarray(planes)})[0][0]
            labels.append(label)
            verdicts.append(int(logits.argmax()))
    return np.array(labels), np.array(verdicts)


def figures(labels, verdicts):
    """What counts of a screen."""
    occupied, empty = labels == OCCUPIED, labels == EMPTY

    def rate(wrong, of):
        return round(float(wrong[of].mean()), 4) if of.any() else None

    return {
        "frames": len(labels),
        "occupied": int(occupied.sum()),
        "false-empty rate": rate(verdicts == EMPTY, occupied),
        "empty frames recognised": rate(verdicts == EMPTY, empty),
    }


def train(training, arguments):
    """A screen trained on the clips, classes weighed by how rare they are, a missed object by --weight more."""
    random = np.random.default_rng(arguments.seed)
    labels = np.concatenate([of_clip for _, _, of_clip in training])
    places = [(clip, frame) for clip, (_, _, found) in enumerate(training) for frame in range(len(found))]
    counts = np.bincount(labels, minlength=2)
    if counts.min() == 0:
        sys.exit(f"the clips to train on hold {counts[EMPTY]} empty and {counts[OCCUPIED]} occupied frames: both are needed")
    weights = torch.tensor((len(labels) / (2 * counts)).astype(np.float32))
    weights[OCCUPIED] *= arguments.weight
    screen = load_screen(arguments.start) if arguments.start else Screen()
    screen = screen.to(memory_format=torch.channels_last)
    smooth = copy.deepcopy(screen).eval()
    optimiser = torch.optim.AdamW(screen.parameters(), lr=arguments.rate, weight_decay=0.02)
    steps = max(1, len(labels) // arguments.batch) * arguments.epochs
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, arguments.rate, total_steps=steps, pct_start=0.2)
    order = np.array([], dtype=int)
    bar = tqdm(range(steps), desc="training", unit="step")
    for step in bar:
        if len(order) < arguments.batch:
            order = np.concatenate([order, random.permutation(len(labels))])
        chosen, order = order[: arguments.batch], order[arguments.batch :]
        pictures = np.stack([training[places[i][0]][1][places[i][1]] for i in chosen])
        batch = torch.from_numpy(pictures).permute(0, 3, 1, 2)
        mirrored = torch.from_numpy(random.random(len(chosen)) < 0.5)[:, None, None, None]
        batch = torch.where(mirrored, batch.flip(3), batch).float() / 255
        batch = (batch * torch.from_numpy(random.uniform(0.7, 1.3, (len(chosen), 1, 1, 1))).float()).clamp(0, 1)
        with torch.autocast("cpu", torch.bfloat16):
            logits = screen(batch.contiguous(memory_format=torch.channels_last))
        loss = functional.cross_entropy(logits.float(), torch.from_numpy(labels[chosen]), weights)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        schedule.step()
        average(smooth, screen, step, most=0.98)
        bar.set_postfix(loss=f"{float(loss.detach()):.3f}")
    return smooth


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--videos", nargs="+", required=True, help="videos, folders of pictures, or folders of such folders; each clip is trained on or validated on as a whole")
    parser.add_argument("--detector", help="ONNX file of the detector that makes the labels")
    parser.add_argument("--head", default="auto", help="how its output is read (default: auto)")
    parser.add_argument("--detections", help="folder of an earlier `albireo eval video … --save-detections`, in place of --detector")
    parser.add_argument("--confidence", type=float, default=0.5, help="a detection counts from here on (default: 0.5)")
    parser.add_argument("--every", type=int, default=2, help="use every n-th frame (default: 2)")
    parser.add_argument("--validation", type=float, default=0.3, help="share of the frames to validate on (default: 0.3)")
    parser.add_argument("--validate-on", metavar="CLIP", nargs="+", help="names of the clips to validate on, in place of a share")
    parser.add_argument("--weight", type=float, default=3.0, help="a missed object costs so much more than a false alarm (default: 3)")
    parser.add_argument("--start", help="screen of this script to train on from (default: random weights)")
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--out", default="screen.onnx")
    arguments = parser.parse_args()
    if not arguments.detector and not arguments.detections:
        parser.error("name the detector that makes the labels (--detector), or a folder of its detections (--detections)")
    torch.manual_seed(arguments.seed)
    torch.set_num_threads(arguments.threads)

    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.detections or temporary
        if not arguments.detections:
            store_detections(arguments, folder)
        clips = []
        for clip in tqdm([clip for path in arguments.videos for clip in clips_of(Path(path))], desc="reading", unit="clip"):
            pictures = pictures_of(clip, arguments.every, temporary)
            frames = len(pictures) * arguments.every
            labels = labels_of(folder, name_of(clip), frames, arguments.confidence)[:: arguments.every]
            # The file stays readable after its folder is gone, until the program ends.
            clips.append((name_of(clip), pictures, labels))
    if arguments.validate_on:
        training = [clip for clip in clips if clip[0] not in arguments.validate_on]
        validation = [clip for clip in clips if clip[0] in arguments.validate_on]
    else:
        training, validation = split_by_clip(clips, arguments.validation)
    for name, part in [("train on", training), ("validate on", validation)]:
        for clip, _, labels in part:
            print(f"{name} {clip}: {len(labels)} frames, {(labels == OCCUPIED).sum()} occupied")

    screen = train(training, arguments)
    export_screen(copy.deepcopy(screen).to(memory_format=torch.contiguous_format), arguments.out)
    report = {"training": figures(*verdicts_of(arguments.out, training))}
    if validation:
        report["validation"] = figures(*verdicts_of(arguments.out, validation))
        if arguments.start:
            report["validation, before training"] = figures(*verdicts_of(arguments.start, validation))
    print(json.dumps(report, indent=1))
    print(f"{arguments.out} written: name it in screen.model if the validation is good enough; if not, add clips")


if __name__ == "__main__":
    main()

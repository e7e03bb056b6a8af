"""Compares albireo's whole pipeline with the vendors' code on the same pictures. Prints tables, and writes them to
models/PARITY.md and small fixtures to tests/fixtures/parity. Run by `make parity`; the exit code is 1 if boxes or scores
for the same pixels differ by more than the tolerance."""

import argparse
import pathlib
import sys

import cv2
import numpy
import onnxruntime
import torch
import transformers
import ultralytics

import fixtures
import pictures
import trained
from detect import detect
from networks import SEED, networks

CONFIDENCE = 0.25
OVERLAP = 0.7
# Tolerances of boxes and scores for the same pixels.
PIXELS = 1.0
SCORE = 1e-3
# Boxes with a score this close to the threshold may be on either side of it.
EDGE = 2e-3


def ours(program, network, model, files, folder):
    """Returns, for each file, albireo's detections as rows like the vendors', and the model's input."""
    more = ["--overlap", str(OVERLAP)]
    if network.name.startswith("rfdetr"):
        # Numbers as names, because some of COCO's category numbers have no name.
        names = pathlib.Path(folder) / "names.txt"
        names.parent.mkdir(parents=True, exist_ok=True)
        names.write_text("".join(f"{number}\n" for number in range(91)))
        more += ["--class-names", names]
    if hasattr(network, "head"):
        more += ["--head", network.head]
    return detect(program, model, files, folder, CONFIDENCE, more)


def matched(first, second):
    """Pairs each box of `first`, best first, with the nearest free box of its class in `second`. Returns the largest
    difference of the corners and that of the scores, or None."""
    free = list(range(len(second)))
    pairs = []
    for row in first[numpy.argsort(-first[:, 4], kind="stable")]:
        same = [place for place in free if second[place, 5] == row[5]]
        if not same:
            pairs.append((row, None))
            continue
        # Nearest in position and score, because stacked boxes of one class may differ little.
        distance = [
            numpy.abs(second[place, :4] - row[:4]).max() + 100 * abs(second[place, 4] - row[4])
            for place in same
        ]
        best = same[int(numpy.argmin(distance))]
        pixels = numpy.abs(second[best, :4] - row[:4]).max()
        score = abs(second[best, 4] - row[4])
        if pixels > 32:
            pairs.append((row, None))
            continue
        free.remove(best)
        pairs.append((row, (pixels, score)))
    return pairs


def compare(theirs, ours):
    """Returns the differences of the detections in one picture."""
    # For a box in the letterbox's margin, the vendors' code returns an empty box and albireo none.
    theirs = theirs[(theirs[:, 2] > theirs[:, 0]) & (theirs[:, 3] > theirs[:, 1])]
    edge = CONFIDENCE + EDGE
    pairs = matched(theirs, ours)
    sure = [pair for pair in pairs if pair[0][4] >= edge]
    found = [difference for _, difference in sure if difference]
    back = [pair for pair in matched(ours, theirs) if pair[0][4] >= edge]
    within = [d for d in found if d[0] <= PIXELS and d[1] <= SCORE]
    return {
        "theirs": len(sure),
        "ours": len(back),
        "within": len(within),
        "unmatched": len(sure) - len(found) + sum(difference is None for _, difference in back),
        "pixels": [d[0] for d in found],
        "scores": [d[1] for d in found],
    }


def row(name, what, results):
    pixels = numpy.concatenate([result["pixels"] for result in results] or [[]])
    scores = numpy.concatenate([result["scores"] for result in results] or [[]])
    total = {key: sum(result[key] for result in results) for key in ("theirs", "ours", "within", "unmatched")}
    def spread(values, digits):
        if not len(values):
            return "none"
        three = numpy.median(values), numpy.quantile(values, 0.95), values.max()
        return " / ".join(f"{value:.{digits}f}" for value in three)

    line = (
        f"| {name} | {what} | {len(results)} | {total['theirs']} | {total['ours']} | {total['within']} "
        f"| {total['unmatched']} | {spread(pixels, 4)} | {spread(scores, 6)} |"
    )
    return line, total


def control(network, files):
    """Measures how far the boxes of a network move, in PyTorch alone, if every tenth value of its input changes by one
    level."""
    generator = numpy.random.default_rng(SEED)
    results = []
    for file in files:
        tensor = network.tensor(cv2.imread(str(file)))
        level = 1 / 255
        if hasattr(network, "deviation"):
            level = level / network.deviation.numpy()
        steps = generator.choice([-1, 0, 1], tensor.shape, p=[0.05, 0.9, 0.05])
        changed = (tensor + steps * level).astype(numpy.float32)
        theirs, moved = (network.boxes_of(given, CONFIDENCE, OVERLAP) for given in (tensor, changed))
        results.append(compare(theirs, moved))
    return row(network.name, "PyTorch | one level more or less, theirs against theirs", results)[0]


def levels(network, theirs, ours):
    """Returns the differences between two inputs in levels of 0 to 255."""
    factor = 255.0
    if hasattr(network, "deviation"):
        factor = 255.0 * network.deviation.numpy()
    return numpy.abs((theirs - ours) * factor)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", default="target/debug/albireo")
    parser.add_argument("--shared", default="../shared")
    parser.add_argument("--work", default=".cache/vendors/work")
    parser.add_argument("--report", default="models/PARITY.md")
    parser.add_argument("--fixtures", default="tests/fixtures/parity")
    arguments = parser.parse_args()
    torch.set_num_threads(2)
    work = pathlib.Path(arguments.work)
    files = pictures.sources(arguments.shared, work / "pictures")
    boxes, inputs, heads, failed = [], [], [], False
    for network in networks():
        squares = pictures.exact(files, network.side, work / f"pictures_{network.side}")
        network.calibrate([cv2.imread(str(file)) for file in squares])
        model = network.export(work)
        for what, given in (("same pixels", squares), ("own resize", files)):
            head, found = ours(arguments.program, network, model, given, work / network.name / what.split()[0])
            differences = [
                levels(network, network.tensor(cv2.imread(str(file))), tensor)
                for file, (_, tensor) in zip(given, found, strict=True)
            ]
            every = numpy.concatenate([difference.ravel() for difference in differences])
            inputs.append(
                f"| {network.name} | {what} | {every.max():.4f} | {every.mean():.4f} "
                f"| {100 * (every > 0.75).mean():.2f} % | {100 * (every > 1.5).mean():.3f} % |"
            )
            for exported in [False] * network.faithful + [True] * bool(network.exported):
                runner = "ONNX Runtime" if exported else "PyTorch"
                results = []
                for file, (rows, tensor) in zip(given, found, strict=True):
                    picture = cv2.imread(str(file))
                    if exported:
                        theirs = network.predict_exported(picture, tensor, CONFIDENCE, OVERLAP)
                    else:
                        theirs = network.predict(picture, CONFIDENCE, OVERLAP)
                    results.append(compare(theirs, rows))
                    numbers = {key: value for key, value in results[-1].items() if isinstance(value, int)}
                    print(network.name, runner, what, file.name, numbers, flush=True)
                line, total = row(network.name, f"{runner} | {what}", results)
                boxes.append(line)
                if exported:
                    # The same runtime on the same input must agree exactly.
                    failed |= total["within"] < total["theirs"] or total["unmatched"] > 0
                if what == "same pixels":
                    # Two runtimes round differently, so ties may be decided differently.
                    share = 1.0 if exported or not network.exported else getattr(network, "share", 0.98)
                    failed |= total["theirs"] < 300 or total["within"] < share * total["theirs"]
                    failed |= total["unmatched"] > 2 * (1 - share) * total["theirs"]
            if what == "own resize" and network.faithful:
                boxes.append(control(network, given))
            if what == "same pixels":
                heads.append(f"`{network.name}`: `{head}`")
                failed |= every.max() > 0.01
        fixtures.write(network, files, arguments.fixtures)
    resized = trained.rows(arguments.program, arguments.shared, files[: len(pictures.CLIPS)], work / "trained")
    versions = {
        "ultralytics": ultralytics.__version__,
        "rfdetr": __import__("importlib.metadata").metadata.version("rfdetr"),
        "transformers": transformers.__version__,
        "torch": torch.__version__,
        "onnxruntime": onnxruntime.__version__,
        "opencv": cv2.__version__,
    }
    text = pathlib.Path(__file__).with_name("report.md").read_text()
    text = text.replace("{boxes}", "\n".join(boxes)).replace("{inputs}", "\n".join(inputs)).replace("{trained}", "\n".join(resized))
    text = text.replace("{heads}", ", ".join(heads)).replace("{pictures}", str(len(files)))
    text = text.replace("{versions}", ", ".join(f"{name} {version}" for name, version in versions.items()))
    pathlib.Path(arguments.report).write_text(text)
    print(text)
    if failed:
        sys.exit("boxes, scores or inputs of the same pixels differ by more than they may")


if __name__ == "__main__":
    main()

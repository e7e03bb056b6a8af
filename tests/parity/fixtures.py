"""Small fixtures for `make test`: outputs of the random networks with the boxes that the vendors' code derives from them,
and a small picture with the resulting input. Numbers are rounded first, so that both sides read the same values."""

import gzip
import json
import pathlib

import cv2
import numpy
import torch

CONFIDENCE = 0.25
OVERLAP = 0.7


def rounded(tensor, digits):
    """Rounds `tensor` to this many significant digits, as float32."""
    texts = [f"{value:.{digits}g}" for value in tensor.ravel()]
    return numpy.array(texts, numpy.float32).reshape(tensor.shape)


def tensor(values, digits=9):
    numbers = [float(f"{value:.{digits}g}") for value in values.ravel()]
    return {"shape": list(values.shape), "values": numbers}


def save(folder, name, content):
    file = pathlib.Path(folder) / f"{name}.json.gz"
    file.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, separators=(",", ":")).encode()
    file.write_bytes(gzip.compress(text, 9, mtime=0))
    print(file, file.stat().st_size, "bytes")


def write(network, files, folder):
    """Writes the fixtures of one network. The one-to-many head of yolo26n has the layout of yolo11n."""
    if network.name == "yolo11n":
        yolo(network, files, folder)
        picture = sample(files[0])
        letterboxed = ultralytics_input(picture, 64)
        save(folder, "input_yolo", {"picture": tensor(picture), "input": tensor(letterboxed, 7)})
    elif network.name == "yolo26n-one2one":
        end_to_end(network, files, folder)
    elif network.name == "rfdetr-nano":
        detr(network, files, folder)
        picture = sample(files[0])
        save(folder, "input_detr", {"picture": tensor(picture), "input": tensor(rfdetr_input(network, picture, 32), 7)})


def sample(file):
    """Returns a small RGB picture of an odd size."""
    return cv2.resize(cv2.imread(str(file)), (61, 43), interpolation=cv2.INTER_AREA)[:, :, ::-1].copy()


def ultralytics_input(picture, side):
    from ultralytics.data.augment import LetterBox

    square = LetterBox((side, side), auto=False)(image=picture)
    return square.transpose(2, 0, 1).astype(numpy.float32) / 255


def rfdetr_input(network, picture, side):
    from torchvision.transforms import functional

    planes = functional.to_tensor(picture)
    planes = functional.resize(planes, [side, side], antialias=False)
    return functional.normalize(planes, network.model.means, network.model.stds).numpy()


def yolo(network, files, folder):
    from ultralytics.utils.nms import non_max_suppression

    picture = cv2.resize(cv2.imread(str(files[0])), (96, 64), interpolation=cv2.INTER_AREA)
    given = torch.from_numpy(picture[:, :, ::-1].copy()).permute(2, 0, 1)[None] / 255
    with torch.no_grad():
        output = rounded(network.model.model.eval()(given)[0].numpy(), 4)
    # Low enough for many boxes, and halfway between two scores.
    scores = numpy.sort(output[0, 4:].max(0))[::-1]
    many, few = (float((scores[place] + scores[place + 1]) / 2) for place in (90, 20))
    cases = []
    for confidence, overlap, per_class, most in (
        (few, OVERLAP, True, 300),
        (many, OVERLAP, True, 300),
        (many, 0.45, True, 300),
        (many, 0.45, False, 300),
        (many, 0.8, True, 20),
    ):
        [found] = non_max_suppression(
            torch.from_numpy(output), confidence, overlap, agnostic=not per_class, max_det=most
        )
        settings = {"confidence": confidence, "overlap": overlap, "per_class": per_class, "most": most}
        cases.append({**settings, "boxes": tensor(found.numpy())})
        print("yolo fixture:", settings, len(found), "boxes")
    save(folder, "head_yolo", {"columns": 96, "rows": 64, "outputs": [tensor(output, 4)], "cases": cases})


def end_to_end(network, files, folder):
    from ultralytics.utils.nms import non_max_suppression

    picture = cv2.imread(str(files[1]))
    [output] = network.raw(network.tensor(picture))
    output = rounded(output.reshape(1, -1, 6), 6)
    [found] = non_max_suppression(torch.from_numpy(output), CONFIDENCE, OVERLAP, end2end=True)
    case = {"confidence": CONFIDENCE, "overlap": OVERLAP, "per_class": True, "most": 300}
    content = {"columns": 640, "rows": 640, "outputs": [tensor(output, 6)]}
    save(folder, "head_end_to_end", {**content, "cases": [{**case, "boxes": tensor(found.numpy())}]})


def detr(network, files, folder):
    from rfdetr.models.postprocess import PostProcess

    boxes, logits = network.raw(network.tensor(cv2.imread(str(files[1]))))
    boxes, logits = rounded(boxes[:, :80], 5), rounded(logits[:, :80], 4)
    outputs = {"pred_boxes": torch.from_numpy(boxes), "pred_logits": torch.from_numpy(logits)}
    [found] = PostProcess(num_select=80)(outputs, torch.tensor([[network.side, network.side]]))
    rows = torch.column_stack([found["boxes"], found["scores"], found["labels"]])
    rows = rows[found["scores"] > CONFIDENCE].numpy()
    print("detr fixture:", len(rows), "boxes")
    case = {"confidence": CONFIDENCE, "overlap": OVERLAP, "per_class": True, "most": 300}
    content = {
        "columns": network.side,
        "rows": network.side,
        "names": ["dets", "labels"],
        "outputs": [tensor(boxes, 5), tensor(logits, 4)],
        "cases": [{**case, "boxes": tensor(rows)}],
    }
    save(folder, "head_detr", content)

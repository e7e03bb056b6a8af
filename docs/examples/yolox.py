"""YOLOX-Nano by ONNX Runtime in Python. Needs `pip install onnxruntime pillow`."""

import pathlib

import numpy as np
import onnxruntime
from PIL import Image


def pictures(folder):
    """The JPEG files of a folder, in order, as arrays of shape (rows, columns, 3)."""
    return [np.asarray(Image.open(file)) for file in sorted(pathlib.Path(folder).glob("*.jpg"))]


class Yolox:
    """Finds COCO's 80 classes: `model(image)` returns (xyxy, confidence, class_id)."""

    def __init__(self, file="models/yolox_nano.onnx", side=416, least=0.3, overlap=0.5):
        self.session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
        self.side, self.least, self.overlap = side, least, overlap

    def __call__(self, image):
        rows, columns = image.shape[:2]
        scale = self.side / max(rows, columns)
        small = Image.fromarray(image).resize((int(columns * scale), int(rows * scale)), Image.Resampling.BILINEAR)
        # The picture in the upper left corner of the smallest input that holds it, the rest grey; blue before red.
        shape = [-(-side // 32) * 32 for side in (small.height, small.width)]
        filled = np.full((*shape, 3), 114, np.float32)
        filled[: small.height, : small.width] = np.asarray(small)[..., ::-1]
        (found,) = self.session.run(None, {"images": filled.transpose(2, 0, 1)[None]})[0]
        cells = []
        for stride in (8, 16, 32):
            y, x = np.mgrid[: shape[0] // stride, : shape[1] // stride]
            cells.append(np.stack([x, y, np.full_like(x, stride)], -1).reshape(-1, 3))
        cells = np.concatenate(cells)
        stride = cells[:, 2:]
        centre = (found[:, :2] + cells[:, :2]) * stride / scale
        half = np.exp(found[:, 2:4]) * stride / scale / 2
        scores = found[:, 4:5] * found[:, 5:]
        confidence, class_id = scores.max(1), scores.argmax(1)
        order = np.argsort(-confidence)
        order = order[confidence[order] >= self.least]
        xyxy = np.concatenate([centre - half, centre + half], 1)[order]
        kept = self.distinct(xyxy, class_id[order])
        return xyxy[kept], confidence[order][kept], class_id[order][kept]

    def distinct(self, xyxy, class_id):
        """The boxes, best first, that overlap no better one of their class."""
        kept = []
        area = np.prod(xyxy[:, 2:] - xyxy[:, :2], 1)
        for i, box in enumerate(xyxy):
            shared = np.minimum(box[2:], xyxy[kept, 2:]) - np.maximum(box[:2], xyxy[kept, :2])
            shared = np.prod(shared.clip(0), 1)
            union = area[i] + area[kept] - shared
            if not np.any((shared > self.overlap * union) & (class_id[kept] == class_id[i])):
                kept.append(i)
        return np.array(kept, int)

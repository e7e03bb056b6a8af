"""The vendors' detectors with random weights: built offline, calibrated to find something, run by the vendors' code, and
exported by their exporters.

A network with random weights gives nearly the same score everywhere. To get hundreds of boxes of different classes, sizes
and scores, the last layer of each branch is scaled so that its outputs on one calibration picture have a chosen mean and
spread. The weights stay random: the comparison covers arithmetic, not accuracy.
"""

import json
import pathlib
import types

import cv2
import numpy
import onnxruntime
import torch
from rfdetr import RFDETRNano
from rfdetr.models.postprocess import PostProcess
from transformers import (
    DFineConfig,
    DFineForObjectDetection,
    RTDetrConfig,
    RTDetrForObjectDetection,
    RTDetrImageProcessor,
)
from ultralytics import RTDETR, YOLO
from ultralytics.utils.nms import non_max_suppression
from ultralytics.utils.ops import scale_boxes

SEED = 7


def spread(layer, inputs, middle, most):
    """Scales `layer` (linear, or a 1x1 convolution) so that each of its outputs has the median `middle` over `inputs`
    (rows of features) and differs from it by at most `most`."""
    outputs = inputs @ layer.weight.data.flatten(1).T
    median = outputs.median(0).values
    scale = most / (outputs - median).abs().amax(0).clamp(min=1e-12)
    layer.weight.data.mul_(scale.reshape(-1, *[1] * (layer.weight.dim() - 1)))
    layer.bias.data.copy_(middle - median * scale)


def batch(pictures):
    """Converts pictures of one size (BGR) to planes of red, green and blue from 0 to 1."""
    stacked = numpy.stack([picture[:, :, ::-1] for picture in pictures])
    return torch.from_numpy(stacked).permute(0, 3, 1, 2) / 255


def normalise(network, run):
    """Sets the mean and variance of each batch normalisation to those of its inputs during `run`: with the initial ones
    all values would fade to 0."""
    layers = [layer for layer in network.modules() if isinstance(layer, torch.nn.BatchNorm2d)]
    momenta = [layer.momentum for layer in layers]
    for layer in layers:
        layer.momentum = 1.0
        layer.train()
    with torch.no_grad():
        run()
    for layer, momentum in zip(layers, momenta, strict=True):
        layer.momentum = momentum
        layer.eval()


def features(run, layers):
    """Returns the inputs of each of `layers` during `run` as rows."""
    kept = {}

    def keep(layer):
        def hook(_, inputs):
            value = inputs[0].detach()
            value = value.permute(0, 2, 3, 1) if value.dim() == 4 and isinstance(layer, torch.nn.Conv2d) else value
            kept[layer] = value.reshape(-1, value.shape[-1])

        return layer.register_forward_pre_hook(hook)

    hooks = [keep(layer) for layer in layers]
    with torch.no_grad():
        run()
    for hook in hooks:
        hook.remove()
    return kept


class Ultralytics:
    """yolo11n, or yolo26n with either of its heads."""

    side = 640
    exported = None
    # PyTorch computes the same network that was exported.
    faithful = True

    def __init__(self, name, end_to_end):
        torch.manual_seed(SEED)
        self.name = name + ("" if end_to_end is None else "-one2one" if end_to_end else "-one2many")
        self.end_to_end = end_to_end
        self.model = YOLO(f"{name}.yaml")

    def calibrate(self, pictures):
        """`pictures` are BGR and of the network's input size."""
        network = self.model.model.eval()
        head = network.model[-1]
        branches = [(head.cv2, head.cv3)]
        if self.end_to_end is not None:
            branches.append((head.one2one_cv2, head.one2one_cv3))
        tensor = batch(pictures)
        normalise(network, lambda: network(tensor))
        layers = [level[-1] for branch in branches for part in branch for level in part]
        inputs = features(lambda: network(tensor), layers)
        for boxes, classes in branches:
            for level in boxes:
                # Distances from the anchor to the four sides, in strides: as a distribution or directly.
                middle, most = (0.0, 6.0) if head.reg_max > 1 else (4.0, 3.0)
                spread(level[-1], inputs[level[-1]], middle, most)
            for level in classes:
                spread(level[-1], inputs[level[-1]], -6.0, 9.0)

    def export(self, folder, **more):
        file = self.model.export(
            format="onnx",
            imgsz=self.side,
            opset=17,
            simplify=False,
            device="cpu",
            nms=False if self.end_to_end else None,
            **more,
        )
        target = pathlib.Path(folder) / f"{self.name}.onnx"
        pathlib.Path(file).replace(target)
        self.exported = session(target)
        return target

    def boxes_of(self, tensor, confidence, overlap):
        """Returns the boxes from PyTorch and the vendor's postprocessing, in pixels of the input."""
        [output] = self.raw(tensor)
        output = torch.from_numpy(output)
        [found] = non_max_suppression(output, confidence, overlap, max_det=300, end2end=bool(self.end_to_end))
        return found.numpy().astype(numpy.float64)

    def predict_exported(self, picture, tensor, confidence, overlap):
        """Like `predict`, but with the export in ONNX Runtime on albireo's input tensor, followed by the vendor's
        postprocessing. Inputs are compared separately: albireo multiplies by 1/255, the vendor divides by 255."""
        tensor = tensor[None]
        [output] = self.exported.run(None, {self.exported.get_inputs()[0].name: tensor})
        output = torch.from_numpy(output)
        [found] = non_max_suppression(output, confidence, overlap, max_det=300, end2end=bool(self.end_to_end))
        found[:, :4] = scale_boxes(tensor.shape[2:], found[:, :4], picture.shape)
        return found.numpy().astype(numpy.float64)

    def predict(self, picture, confidence, overlap):
        """Returns rows of x1, y1, x2, y2, score, class, in pixels of `picture` (BGR)."""
        [result] = self.model.predict(
            picture,
            imgsz=self.side,
            rect=False,
            conf=confidence,
            iou=overlap,
            max_det=300,
            nms=False if self.end_to_end else None,
            device="cpu",
            verbose=False,
        )
        return result.boxes.data.numpy().astype(numpy.float64)

    def tensor(self, picture):
        """Returns the network's input for `picture` (BGR): planes of float32."""
        if self.model.predictor is None:
            self.predict(picture, 0.5, 0.5)
        return self.model.predictor.preprocess([picture])[0].numpy()

    def raw(self, tensor):
        """Returns the output for an input."""
        with torch.no_grad():
            return [self.model.predictor.model(torch.from_numpy(tensor)[None])[0].numpy()]


class Quantised(Ultralytics):
    """yolo26n in int8, quantised by the vendor's exporter."""

    # Rounding to 256 levels can move the boxes of a random network anywhere, so only the export is compared.
    faithful = False

    def __init__(self):
        super().__init__("yolo26n", True)
        self.name = "yolo26n-int8"

    def calibrate(self, pictures):
        super().calibrate(pictures)
        self.pictures = pictures

    def export(self, folder):
        """Exports the network, quantised with its calibration pictures."""
        data = pathlib.Path(folder).resolve() / "int8"
        for kind in ("images", "labels"):
            (data / kind).mkdir(parents=True, exist_ok=True)
        for number, picture in enumerate(self.pictures):
            cv2.imwrite(str(data / f"images/{number}.png"), picture)
            # The data set reader requires an object in each picture; any will do.
            (data / f"labels/{number}.txt").write_text("0 0.5 0.5 0.1 0.1\n")
        listing = {"path": str(data), "train": "images", "val": "images", "names": self.model.names}
        (data / "data.yaml").write_text(json.dumps(listing))
        return super().export(folder, quantize=8, data=str(data / "data.yaml"))


class RfDetr:
    """RF-DETR Nano."""

    side = 384
    exported = None
    faithful = True
    name = "rfdetr-nano"

    def __init__(self):
        torch.manual_seed(SEED)
        self.model = RFDETRNano(pretrain_weights=None, device="cpu")
        self.mean = torch.tensor(self.model.means)[:, None, None]
        self.deviation = torch.tensor(self.model.stds)[:, None, None]

    def calibrate(self, pictures):
        network = self.model.model.model.eval()
        tensor = (batch(pictures) - self.mean) / self.deviation
        last = network.bbox_embed.layers[-1]
        torch.nn.init.normal_(last.weight, std=0.02)
        inputs = features(lambda: network(tensor), [network.class_embed])
        spread(network.class_embed, inputs[network.class_embed], -5.0, 7.0)

    def export(self, folder):
        target = pathlib.Path(folder) / f"{self.name}.onnx"
        made = self.model.export(output_dir=str(folder), format="onnx", opset_version=17)
        made = pathlib.Path(made)
        if made.is_dir():
            [made] = made.glob("*.onnx")
        made.replace(target)
        return target

    def boxes_of(self, tensor, confidence, overlap):
        del overlap
        boxes, logits = map(torch.from_numpy, self.raw(tensor))
        outputs = {"pred_boxes": boxes, "pred_logits": logits}
        [found] = PostProcess(num_select=300)(outputs, torch.tensor([[self.side, self.side]]))
        rows = torch.column_stack([found["boxes"], found["scores"], found["labels"]])
        return rows[found["scores"] > confidence].numpy().astype(numpy.float64)

    def predict(self, picture, confidence, overlap):
        del overlap
        found = self.model.predict(picture[:, :, ::-1], threshold=confidence)
        return numpy.column_stack([found.xyxy, found.confidence, found.class_id]).astype(numpy.float64)

    def tensor(self, picture):
        given = []
        network = self.model.model.model
        hook = network.register_forward_pre_hook(lambda _, inputs: given.append(inputs[0].detach()))
        self.predict(picture, 0.5, 0.5)
        hook.remove()
        return given[0][0].numpy()

    def raw(self, tensor):
        with torch.no_grad():
            found = self.model.model.model(torch.from_numpy(tensor)[None])
        return [found["pred_boxes"].numpy(), found["pred_logits"].numpy()]


def session(model):
    """Opens an export in ONNX Runtime with one thread, like albireo, so that sums agree to the last bit."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(model, options)


def inside(rows, height, width):
    """Cuts boxes off at the border of a picture of this size, which the vendors' code does for YOLO only."""
    rows = rows.astype(numpy.float64)
    rows[:, [0, 2]] = rows[:, [0, 2]].clip(0, width)
    rows[:, [1, 3]] = rows[:, [1, 3]].clip(0, height)
    return rows


class UltralyticsRtDetr(Ultralytics):
    """RT-DETR-L of Ultralytics."""

    # With random weights many queries are nearly equal, and rounding decides which of them are kept.
    share = 0.85
    name = "rtdetr-l"
    end_to_end = None

    def __init__(self):
        torch.manual_seed(SEED)
        self.model = RTDETR(f"{self.name}.yaml")

    def calibrate(self, pictures):
        network = self.model.model.eval()
        head = network.model[-1]
        tensor = batch(pictures)
        normalise(network, lambda: network(tensor))
        torch.nn.init.normal_(head.dec_bbox_head[-1].layers[-1].weight, std=0.02)
        last = head.dec_score_head[-1]
        spread(last, features(lambda: network(tensor), [last])[last], -5.0, 7.0)

    def boxes(self, output, picture, confidence):
        """Returns the boxes that the vendor's last step makes of the network's output."""
        predictor = self.model.predictor
        predictor.args.conf = confidence
        predictor.batch = [["picture"]]
        [result] = predictor.postprocess(output, torch.zeros(1, 3, self.side, self.side), [picture])
        return inside(result.boxes.data.numpy(), *picture.shape[:2])

    def boxes_of(self, tensor, confidence, overlap):
        del overlap
        [output] = self.raw(tensor)
        square = numpy.zeros((self.side, self.side, 3), numpy.uint8)
        return self.boxes(torch.from_numpy(output), square, confidence)

    def predict_exported(self, picture, tensor, confidence, overlap):
        del overlap
        [output] = self.exported.run(None, {"images": tensor[None]})
        return self.boxes(torch.from_numpy(output), picture, confidence)

    def predict(self, picture, confidence, overlap):
        return inside(super().predict(picture, confidence, overlap), *picture.shape[:2])


class Transformers:
    """A detector of transformers, exported by PyTorch with the names of its outputs, as optimum does."""

    side = 640
    exported = None
    # With random weights thousands of queries are nearly equal, and rounding decides which 300 of them are kept.
    faithful = False
    # Nothing in the export says how it wants its pictures.
    head = "rt-detr"

    def __init__(self, name, configuration, network):
        torch.manual_seed(SEED)
        self.name = name
        self.network = network(configuration(num_labels=80)).eval()
        self.processor = RTDetrImageProcessor(size={"height": self.side, "width": self.side})

    def calibrate(self, pictures):
        tensor = batch(pictures)
        normalise(self.network, lambda: self.network(tensor))
        decoder = self.network.model.decoder
        last = decoder.class_embed[-1]
        spread(last, features(lambda: self.network(tensor), [last])[last], -5.0, 7.0)

    def export(self, folder):
        target = pathlib.Path(folder) / f"{self.name}.onnx"

        class Outputs(torch.nn.Module):
            def __init__(self, network):
                super().__init__()
                self.network = network

            def forward(self, pixel_values):
                found = self.network(pixel_values)
                return found.logits, found.pred_boxes

        torch.onnx.export(
            Outputs(self.network),
            (torch.zeros(1, 3, self.side, self.side),),
            str(target),
            input_names=["pixel_values"],
            output_names=["logits", "pred_boxes"],
            opset_version=17,
            dynamo=False,
        )
        self.exported = session(target)
        return target

    def boxes(self, logits, boxes, size, confidence):
        found = types.SimpleNamespace(logits=logits, pred_boxes=boxes)
        [found] = self.processor.post_process_object_detection(found, threshold=confidence, target_sizes=[size])
        rows = torch.column_stack([found["boxes"], found["scores"], found["labels"]])
        return inside(rows.numpy(), *size)

    def boxes_of(self, tensor, confidence, overlap):
        del overlap
        logits, boxes = map(torch.from_numpy, self.raw(tensor))
        return self.boxes(logits, boxes, (self.side, self.side), confidence)

    def predict_exported(self, picture, tensor, confidence, overlap):
        del overlap
        logits, boxes = map(torch.from_numpy, self.exported.run(None, {"pixel_values": tensor[None]}))
        return self.boxes(logits, boxes, picture.shape[:2], confidence)

    def predict(self, picture, confidence, overlap):
        del overlap
        logits, boxes = map(torch.from_numpy, self.raw(self.tensor(picture)))
        return self.boxes(logits, boxes, picture.shape[:2], confidence)

    def tensor(self, picture):
        given = self.processor(images=picture[:, :, ::-1].copy(), return_tensors="pt")
        return given["pixel_values"][0].numpy()

    def raw(self, tensor):
        with torch.no_grad():
            found = self.network(torch.from_numpy(tensor)[None])
        return [found.logits.numpy(), found.pred_boxes.numpy()]


def networks():
    """All networks to compare."""
    return [
        Ultralytics("yolo11n", None),
        Ultralytics("yolo26n", True),
        Ultralytics("yolo26n", False),
        Quantised(),
        Ultralytics("yolov10n", True),
        RfDetr(),
        UltralyticsRtDetr(),
        Transformers("transformers-rt-detr", RTDetrConfig, RTDetrForObjectDetection),
        Transformers("transformers-d-fine", DFineConfig, DFineForObjectDetection),
    ]

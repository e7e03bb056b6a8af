"""The two demonstration networks and how they are exported to ONNX."""

import json

import onnx
import torch
from torch import nn
from torch.nn import functional

from dataset import CLASSES, DETECTOR_SIZE, SCREEN_SIZE

STRIDES = (4, 8, 16)


def convolution(inputs, outputs, kernel=3, stride=1, groups=1):
    """Convolution, batch normalisation, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """A narrowing 1x1 and a 3x3 convolution beside an identity."""

    def __init__(self, channels, inner):
        super().__init__()
        self.body = nn.Sequential(convolution(channels, inner, 1), convolution(inner, channels))

    def forward(self, features):
        return features + self.body(features)


class Pyramid(nn.Module):
    """Pools of three sizes beside each other, so that a cell sees a large vehicle whole."""

    def __init__(self, channels):
        super().__init__()
        self.narrow = convolution(channels, channels // 2, 1)
        self.widen = convolution(channels * 2, channels, 1)

    def forward(self, features):
        first = self.narrow(features)
        second = functional.max_pool2d(first, 5, 1, 2)
        third = functional.max_pool2d(second, 5, 1, 2)
        return self.widen(torch.cat([first, second, third, functional.max_pool2d(third, 5, 1, 2)], 1))


class Head(nn.Module):
    """Four distances and seven class logits for each cell."""

    def __init__(self, channels):
        super().__init__()
        self.body = convolution(channels, channels)
        self.boxes = nn.Conv2d(channels, 4, 1)
        self.classes = nn.Conv2d(channels, len(CLASSES), 1)
        nn.init.constant_(self.boxes.bias, 0.7)
        nn.init.constant_(self.classes.bias, -4.6)

    def forward(self, features):
        features = self.body(features)
        return torch.cat([self.boxes(features), self.classes(features)], 1)


class Detector(nn.Module):
    """Anchor-free, three strides, a top-down pyramid. `forward` gives [n, 11, cells] undecoded;
    `decode` makes boxes and scores of it."""

    def __init__(self):
        super().__init__()
        self.stem = convolution(3, 16, stride=2)
        self.stage4 = nn.Sequential(convolution(16, 24, stride=2), Residual(24, 24))
        self.stage8 = nn.Sequential(convolution(24, 48, stride=2), Residual(48, 24), Residual(48, 24))
        self.stage16 = nn.Sequential(convolution(48, 64, stride=2), Residual(64, 32))
        self.stage32 = nn.Sequential(
            convolution(64, 64, stride=2, groups=64), convolution(64, 96, 1), Pyramid(96)
        )
        self.from32 = convolution(96, 48, 1)
        self.from16 = convolution(64, 48, 1)
        self.from8 = convolution(48, 48, 1)
        self.down4 = convolution(48, 24, 1)
        self.from4 = convolution(24, 24, 1)
        self.smooth8 = convolution(48, 48)
        self.heads = nn.ModuleList([Head(24), Head(48), Head(48)])
        columns, rows = DETECTOR_SIZE
        centers = []
        for stride in STRIDES:
            y, x = torch.meshgrid(torch.arange(rows // stride), torch.arange(columns // stride), indexing="ij")
            cells = torch.stack([(x + 0.5) * stride, (y + 0.5) * stride, torch.full_like(x, stride)], -1)
            centers.append(cells.reshape(-1, 3).float())
        self.register_buffer("cells", torch.cat(centers), persistent=False)

    def forward(self, picture):
        at4 = self.stage4(self.stem(picture))
        at8 = self.stage8(at4)
        at16 = self.stage16(at8)
        up32 = self.from32(self.stage32(at16))
        up16 = self.from16(at16) + functional.interpolate(up32, scale_factor=2.0, mode="nearest")
        up8 = self.from8(at8) + functional.interpolate(up16, scale_factor=2.0, mode="nearest")
        up8 = self.smooth8(up8)
        up4 = self.from4(at4) + functional.interpolate(self.down4(up8), scale_factor=2.0, mode="nearest")
        found = [head(level).flatten(2) for head, level in zip(self.heads, (up4, up8, up16))]
        return torch.cat(found, 2)

    def boxes(self, raw):
        """Corners [n, cells, 4] in input pixels of a raw output."""
        sides = raw[:, :4].transpose(1, 2).clamp(max=4.0).exp() * self.cells[:, 2:]
        x, y = self.cells[:, 0], self.cells[:, 1]
        return torch.stack(
            [x - sides[..., 0], y - sides[..., 1], x + sides[..., 2], y + sides[..., 3]], -1
        )

    def decode(self, raw):
        """[n, cells, 4 + 7]: corners in input pixels, class scores."""
        return torch.cat([self.boxes(raw), raw[:, 4:].transpose(1, 2).sigmoid()], 2)


class Decoded(nn.Module):
    """The detector as it is exported."""

    def __init__(self, detector):
        super().__init__()
        self.detector = detector

    def forward(self, picture):
        return self.detector.decode(self.detector(picture))


class Screen(nn.Module):
    """Five convolution blocks, then a small classifier on the strongest and the mean response of each
    channel (after ERD of Liu and Kang, the screen of the paper). `places` is a helper of the training:
    it says for each cell whether an object is there, and is not exported."""

    def __init__(self):
        super().__init__()
        widths, strides = [3, 8, 16, 32, 32, 64], [2, 2, 2, 1, 2]
        self.blocks = nn.Sequential(
            *[convolution(widths[i], widths[i + 1], stride=strides[i]) for i in range(5)]
        )
        self.classifier = nn.Sequential(nn.Linear(128, 32), nn.ReLU(inplace=True), nn.Linear(32, 2))
        self.places = nn.Conv2d(64, 1, 1)
        nn.init.constant_(self.places.bias, -3.0)

    def classify(self, features):
        return self.classifier(torch.cat([features.amax((2, 3)), features.mean((2, 3))], 1))

    def forward(self, picture):
        return self.classify(self.blocks(picture))


def load_screen(path):
    """A screen with the weights of an exported one, to train on from there.

    The export has folded the batch normalisations into the convolutions: they start as plain shifts.
    """
    graph = onnx.load(str(path)).graph
    stored = {tensor.name: torch.from_numpy(onnx.numpy_helper.to_array(tensor).copy()) for tensor in graph.initializer}
    folded = [[stored[name] for name in node.input[1:3]] for node in graph.node if node.op_type in ("Conv", "Gemm")]
    screen = Screen()
    layers = [*screen.blocks, screen.classifier[0], screen.classifier[2]]
    with torch.no_grad():
        for layer, (weights, bias) in zip(layers, folded, strict=True):
            if isinstance(layer, nn.Linear):
                layer.weight.copy_(weights)
                layer.bias.copy_(bias)
            else:
                layer[0].weight.copy_(weights)
                layer[1].bias.copy_(bias)
                layer[1].running_var.fill_(1.0 - layer[1].eps)
    return screen


def average(smooth, module, step, most):
    """Moves the averaged weights towards those of this step, keeping at most the share `most`."""
    keep = min(most, (1 + step) / (10 + step))
    with torch.no_grad():
        for slow, fast in zip(smooth.state_dict().values(), module.state_dict().values()):
            if slow.dtype.is_floating_point:
                slow.lerp_(fast, 1 - keep)
            else:
                slow.copy_(fast)


def parameters(module):
    """Number of trained numbers."""
    return sum(weights.numel() for weights in module.parameters())


def export(module, size, path, output, properties):
    """Writes `module` as ONNX (opset 17, IR version at most 9) and returns it loaded."""
    module.eval()
    columns, rows = size
    example = torch.zeros(1, 3, rows, columns)
    torch.onnx.export(
        module,
        (example,),
        str(path),
        input_names=["picture"],
        output_names=[output],
        opset_version=17,
        dynamo=False,
    )
    model = onnx.load(str(path))
    model.ir_version = min(model.ir_version, 9)
    model.producer_name = "albireo"
    model.producer_version = ""
    for key, value in properties.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value if isinstance(value, str) else json.dumps(value)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return model


def export_detector(detector, path):
    """Writes the detector with what a reader of its output must know."""
    properties = {"names": CLASSES, "task": "detect", "head": "demonstration"}
    return export(Decoded(detector), DETECTOR_SIZE, path, "detections", properties)


def export_screen(screen, path):
    """Writes the screen."""
    properties = {"names": ["empty", "non-empty"], "task": "classify"}
    return export(screen, SCREEN_SIZE, path, "logits", properties)

"""The network of an empty-scene screen, and how it is read from and written to ONNX."""

import json

import numpy as np
import onnx
import onnxruntime
import torch
from torch import nn

SCREEN_SIZE = (640, 360)  # columns, rows of its input


def convolution(inputs, outputs, kernel=3, stride=1, groups=1):
    """Convolution, batch normalisation, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Screen(nn.Module):
    """Five convolution blocks, then a small classifier on the strongest and the mean response of each
    channel (after ERD of Liu and Kang, the screen of the paper)."""

    def __init__(self):
        super().__init__()
        widths, strides = [3, 8, 16, 32, 32, 64], [2, 2, 2, 1, 2]
        self.blocks = nn.Sequential(
            *[convolution(widths[i], widths[i + 1], stride=strides[i]) for i in range(5)]
        )
        self.classifier = nn.Sequential(nn.Linear(128, 32), nn.ReLU(inplace=True), nn.Linear(32, 2))

    def forward(self, picture):
        features = self.blocks(picture)
        return self.classifier(torch.cat([features.amax((2, 3)), features.mean((2, 3))], 1))


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


def session(path):
    """An ONNX Runtime session on the CPU."""
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def export_screen(screen, path):
    """Writes the screen as ONNX (opset 17, IR version at most 9); fails unless ONNX Runtime answers as PyTorch does."""
    screen.eval()
    columns, rows = SCREEN_SIZE
    picture = torch.rand(1, 3, rows, columns, generator=torch.Generator().manual_seed(3))
    names = {"input_names": ["picture"], "output_names": ["logits"]}
    torch.onnx.export(screen, (picture,), str(path), **names, opset_version=17, dynamo=False)
    model = onnx.load(str(path))
    model.ir_version = min(model.ir_version, 9)
    properties = {"names": json.dumps(["empty", "non-empty"]), "task": "classify"}
    onnx.helper.set_model_props(model, properties)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    with torch.no_grad():
        expected = screen(picture).numpy()
    answer = session(path).run(None, {"picture": picture.numpy()})[0]
    if not np.allclose(answer, expected, rtol=1e-3, atol=1e-3):
        raise SystemExit("the exported model does not answer as PyTorch does")

"""Makes of ONNX detectors the variants that `make gpu` measures beside them: an open batch, and half precision.

    variants.py FOLDER MODEL...

writes FOLDER/NAME.open.onnx (float32, any number of pictures in a run) and FOLDER/NAME.half.onnx (float16, the same), and prints
the paths of what it wrote, one per line. What could not be made is said on the error output, and the rest is made all the same.
"""

import pathlib
import sys
import warnings

import onnx
from onnx import TensorProto, numpy_helper
from onnxconverter_common import float16


def constants(graph):
    """The tensors that are given in the file, by name, each with what puts a changed one in its place."""
    for tensor in graph.initializer:
        yield tensor.name, tensor
    for node in graph.node:
        if node.op_type == "Constant":
            for attribute in node.attribute:
                if attribute.name == "value":
                    yield node.output[0], attribute.t


def open_batch(model):
    """The first dimension of inputs and outputs becomes open; shapes that say 1 there take it from what they reshape."""
    graph = model.graph
    for value in [*graph.input, *graph.output]:
        first = value.type.tensor_type.shape.dim[0]
        if first.dim_value > 1:
            raise ValueError(f"{value.name} has a batch of {first.dim_value}")
        first.dim_param = "batch"
    known = dict(constants(graph))
    shapes = {node.input[1] for node in graph.node if node.op_type == "Reshape"}
    for name in shapes & known.keys():
        shape = numpy_helper.to_array(known[name]).copy()
        if shape.ndim == 1 and len(shape) > 1 and shape[0] == 1:
            shape[0] = 0
            known[name].CopyFrom(numpy_helper.from_array(shape, known[name].name))
    # What was inferred for a batch of 1.
    del graph.value_info[:]
    onnx.checker.check_model(model)
    return model


def half(model):
    """Every float32 becomes float16, but for operators that have no such form, which are left between casts."""
    casts = {node.output[0] for node in model.graph.node if node.op_type == "Cast" and target(node).i == TensorProto.FLOAT}
    model = float16.convert_float_to_float16(model)
    # The converter takes the results of the model's own casts for float16 and leaves the casts as they were.
    for node in model.graph.node:
        if node.op_type == "Cast" and node.output[0] in casts:
            target(node).i = TensorProto.FLOAT16
    # What was inferred before the casts were changed.
    del model.graph.value_info[:]
    onnx.checker.check_model(model, full_check=True)
    return model


def target(cast):
    return next(attribute for attribute in cast.attribute if attribute.name == "to")


def main(folder, *models):
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    # One for each weight that is too small for half precision.
    warnings.filterwarnings("ignore", message=".*will be truncated.*")
    for name in map(pathlib.Path, models):
        made = {}
        try:
            made["open"] = open_batch(onnx.load(name))
        except Exception as error:  # whatever a stranger's file brings
            print(f"{name.name}: no open batch: {error}", file=sys.stderr)
        try:
            whole = open_batch(onnx.load(name)) if "open" in made else onnx.load(name)
            made["half"] = half(whole)
        except Exception as error:
            print(f"{name.name}: no half precision: {error}", file=sys.stderr)
        for kind, model in made.items():
            path = folder / f"{name.stem}.{kind}.onnx"
            onnx.save(model, path)
            print(path)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])

"""Puts a detector's boxes and another model's computation into one ONNX file: a load for trials with cameras.

    load.py DETECTOR LOAD OUT

The pictures go through both models. The detector's outputs come out unchanged, so that objects are found, tracked and skipped as
with the detector; the other model adds nothing but its time. It may be an architecture without training. Where its weights are
missing from the file (`--without-weights FILE OUT` removes them and notes their deviation), they are filled with random numbers.

The input is the detector's. For the other model it is resized and scaled to 0..1. Both need an open batch, or neither; half precision
may be that of one alone.
"""

import json
import sys

import numpy
import onnx
from onnx import TensorProto, compose, helper, numpy_helper

# The key under which a file without its weights notes them.
NOTE = "weights"


def without_weights(model):
    """Removes the weights of convolutions and products, and notes shape, type and deviation of each."""
    notes, kept = {}, []
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype.kind == "f" and values.size > 256:
            notes[tensor.name] = [list(values.shape), tensor.data_type, float(values.std())]
        else:
            kept.append(tensor)
    del model.graph.initializer[:]
    model.graph.initializer.extend(kept)
    helper.set_model_props(model, {NOTE: json.dumps(notes)})
    return model


def filled(model):
    """Gives a file without its weights random ones of the same deviation."""
    notes = {entry.key: entry.value for entry in model.metadata_props}.get(NOTE)
    generator = numpy.random.default_rng(1)
    for name, (shape, data_type, deviation) in json.loads(notes or "{}").items():
        values = generator.normal(0, deviation, shape).astype(helper.tensor_dtype_to_np_dtype(data_type))
        model.graph.initializer.append(numpy_helper.from_array(values, name))
    return model


def sides(value):
    return [dimension.dim_param or dimension.dim_value for dimension in value.type.tensor_type.shape.dim]


def together(detector, load):
    """One graph: the detector's, and the load behind a resize; its result is turned to 0 and added to the first output."""
    detector, load = compose.add_prefix(detector, "detector/"), compose.add_prefix(filled(load), "load/")
    for model in (detector, load):
        del model.graph.value_info[:]
    picture, load_input = detector.graph.input[0], load.graph.input[0]
    output, load_output = detector.graph.output[0], load.graph.output[0]
    kind, load_kind = (value.type.tensor_type.elem_type for value in (picture, load_input))
    scale = [side / own for side, own in zip(sides(load_input)[2:], sides(picture)[2:])]
    constants = [
        numpy_helper.from_array(numpy.array([1, 1, *scale], numpy.float32), "mix/scale"),
        numpy_helper.from_array(numpy.array(1 / 255, helper.tensor_dtype_to_np_dtype(kind)), "mix/unit"),
        numpy_helper.from_array(numpy.array(1.2345e30, numpy.float32), "mix/never"),
    ]
    before = [
        helper.make_node("Mul", [picture.name, "mix/unit"], ["mix/scaled"]),
        helper.make_node("Resize", ["mix/scaled", "", "mix/scale"], ["mix/resized"], mode="nearest"),
        helper.make_node("Cast", ["mix/resized"], [load_input.name], to=load_kind),
    ]
    given = output.name + "/alone"
    for node in detector.graph.node:
        node.output[:] = [given if name == output.name else name for name in node.output]
        node.input[:] = [given if name == output.name else name for name in node.input]
    rank = len(sides(output))
    axes = list(range(1, len(sides(load_output))))
    shape = numpy.array([-1] + [1] * (rank - 1), numpy.int64)
    constants.append(numpy_helper.from_array(shape, "mix/shape"))
    # No model finds just this number, nor is infinity equal to it, nor what is not a number: so 0 in any case, which ONNX Runtime
    # cannot know beforehand.
    after = [
        helper.make_node("ReduceMax", [load_output.name], ["mix/largest"], axes=axes, keepdims=0),
        helper.make_node("Cast", ["mix/largest"], ["mix/single"], to=TensorProto.FLOAT),
        helper.make_node("Equal", ["mix/single", "mix/never"], ["mix/is"]),
        helper.make_node("Cast", ["mix/is"], ["mix/zero"], to=output.type.tensor_type.elem_type),
        helper.make_node("Reshape", ["mix/zero", "mix/shape"], ["mix/column"]),
        helper.make_node("Add", [given, "mix/column"], [output.name]),
    ]
    graph = helper.make_graph(
        [*detector.graph.node, *before, *load.graph.node, *after],
        "load",
        [picture],
        [*detector.graph.output],
        [*detector.graph.initializer, *load.graph.initializer, *constants],
    )
    opset = max(entry.version for model in (detector, load) for entry in model.opset_import if entry.domain == "")
    # ReduceMax takes its axes as an attribute up to 17.
    assert opset <= 17, f"opset {opset} is not tried: export with 17 or less"
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    helper.set_model_props(model, {entry.key: entry.value for entry in detector.metadata_props})
    return compose_names(model, detector)


def compose_names(model, detector):
    """Inputs and outputs get back the names without prefix, by which heads are recognised."""
    names = {value.name: value.name.removeprefix("detector/") for value in [*detector.graph.input, *detector.graph.output]}
    for node in model.graph.node:
        node.input[:] = [names.get(name, name) for name in node.input]
        node.output[:] = [names.get(name, name) for name in node.output]
    for value in [*model.graph.input, *model.graph.output]:
        value.name = names.get(value.name, value.name)
    return model


def main(*arguments):
    if arguments[0] == "--without-weights":
        onnx.save(without_weights(onnx.load(arguments[1])), arguments[2])
    else:
        detector, load, out = arguments
        onnx.save(together(onnx.load(detector), onnx.load(load)), out)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])

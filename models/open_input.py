"""Opens height and width of an exported detector, so that albireo can run it at the smallest input that holds a camera's
picture. For fully convolutional graphs that reshape by the sizes they meet, as YOLOX's exporter writes them; one with
sizes written into it is refused. The same file always gives the same bytes.

    python models/open_input.py yolox_nano_416.onnx models/yolox_nano.onnx

Needs the PyPI package `onnx`.
"""

import argparse
import hashlib
import pathlib
import sys

import onnx
from onnx import numpy_helper

# The published files whose opened form is in this folder, by their digests before and after.
KNOWN = {
    # YOLOX-Nano.
    "d39bee73564e338080378b0ad567fbb40e818b55bbfaf971de82a0267ed16b8a":
        "8648f7111ea4bb0d62d0d115557c5bfab0eb339f65b7bb6a303df3fdc0b1c0fb",
}


def constants(graph):
    """Returns the constant tensors of the graph by their names."""
    found = {tensor.name: tensor for tensor in graph.initializer}
    for node in graph.node:
        if node.op_type == "Constant":
            found[node.output[0]] = node.attribute[0].t
    return found


def fixed_sizes(graph):
    """Returns the nodes that would give another shape than their input asks for: their target is written into the graph."""
    known = constants(graph)
    fixed = []
    for node in graph.node:
        # A reshape may have one side that follows from the others; a resize to a size, and not by a factor, has a fourth
        # input.
        target = {"Reshape": 1, "Expand": 1, "Tile": 1, "Resize": 3}.get(node.op_type, len(node.input))
        if target < len(node.input) and node.input[target] in known:
            sides = numpy_helper.to_array(known[node.input[target]])
            if sides.size:
                fixed.append(f"{node.op_type} {node.name} to {sides.tolist()}")
    return fixed


def opened(model, stride):
    """Returns the model with open height and width, and its former size in the metadata."""
    graph = model.graph
    fixed = fixed_sizes(graph)
    if fixed:
        sys.exit(f"this graph has sizes written into it and cannot be opened: {fixed[0]}. Export it with open sides.")
    if len(graph.input) != 1:
        sys.exit(f"this graph has {len(graph.input)} inputs instead of one picture")
    batch, colours, height, width = graph.input[0].type.tensor_type.shape.dim
    rows, columns = height.dim_value, width.dim_value
    if not rows or not columns or colours.dim_value != 3:
        sys.exit("its input is not [1, 3, rows, columns], or is open already")
    height.dim_param, width.dim_param = "height", "width"
    for output in graph.output:
        for place, side in enumerate(output.type.tensor_type.shape.dim[1:-1]):
            side.dim_param = f"cells{place or ''}"
    # Shapes inferred for the old size.
    del graph.value_info[:]
    for key, value in (("imgsz", f"[{rows}, {columns}]"), ("stride", str(stride))):
        model.metadata_props.add(key=key, value=value)
    return model


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("published", type=pathlib.Path, help="the exported file")
    parser.add_argument("opened", type=pathlib.Path, help="the file to write")
    parser.add_argument("--stride", type=int, default=32, help="the model's largest stride [default: 32]")
    arguments = parser.parse_args()
    published = arguments.published.read_bytes()
    model = opened(onnx.load_model_from_string(published), arguments.stride)
    onnx.checker.check_model(model)
    written = model.SerializeToString(deterministic=True)
    expected = KNOWN.get(hashlib.sha256(published).hexdigest())
    digest = hashlib.sha256(written).hexdigest()
    if expected is not None and digest != expected:
        sys.exit(f"the opened file has the digest {digest} instead of {expected}: is this another version of onnx?")
    arguments.opened.write_bytes(written)
    print(f"{arguments.opened}: sha256 {digest}" + ("" if expected else " (the input is no published file known here)"))


if __name__ == "__main__":
    main()

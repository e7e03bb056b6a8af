//! A small graph in front of a model, which turns pixels into the model's input where the model runs: a GPU is sent a byte
//! for each number instead of four, and the processor is spared the conversion.

use super::ElementType;
use crate::picture::{ColorOrder, InputFormat, TensorLayout};
use ort::editor::{Graph, Model, Node, ONNX_DOMAIN, Opset};
use ort::memory::Allocator;
use ort::operator::Attribute;
use ort::session::builder::SessionBuilder;
use ort::session::{OutputSelector, RunOptions, Session};
use ort::value::{
    DynTensor, Outlet, PrimitiveTensorElementType, Shape, SymbolicDimensions, Tensor,
    TensorElementType, TensorRef, ValueType,
};
use std::fmt::Debug;

/// The version of ONNX whose operators the graph uses; any since 13 has them.
const OPSET: u32 = 17;

const PIXELS: &str = "pixels";

/// The graph as a session, and where its output is put.
pub(super) struct PixelConversion {
    session: Session,
    /// The name of its output.
    output: String,
    /// Memory of the device that runs the model.
    memory: Allocator,
    layout: TensorLayout,
    element: TensorElementType,
}

impl PixelConversion {
    /// Builds the graph that turns `format.as_pixels()` into `format`, in the elements that the model takes.
    /// `memory_for` chooses where the output of the session is put.
    pub(super) fn open(
        format: InputFormat,
        model_element: &ElementType,
        options: &SessionBuilder,
        memory_for: impl FnOnce(&Session) -> ort::Result<Allocator>,
    ) -> ort::Result<Self> {
        let element = match model_element {
            ElementType::Float16 => TensorElementType::Float16,
            ElementType::Uint8 => TensorElementType::Uint8,
            _ => TensorElementType::Float32,
        };
        let mut model = Model::new([Opset::new(ONNX_DOMAIN, OPSET)?])?;
        model.set_graph(graph(format, element)?)?;
        let session = model.into_session(options)?;
        let memory = memory_for(&session)?;
        let output = session.outputs().first().map(|output| output.name().to_owned());
        Ok(Self {
            session,
            output: output.unwrap_or_default(),
            memory,
            layout: format.layout,
            element,
        })
    }

    /// Converts pictures of `shape`, `[batch, rows, columns, 3]`, one after another. The result stays where the model runs.
    pub(super) fn run(&mut self, shape: [i64; 4], pixels: &[u8]) -> ort::Result<DynTensor> {
        let [batch, rows, columns, colours] = shape;
        let converted_shape = match self.layout {
            TensorLayout::Nchw => [batch, colours, rows, columns],
            TensorLayout::Nhwc => shape,
        };
        let converted = DynTensor::new(&self.memory, self.element, converted_shape)?;
        let outputs = OutputSelector::default().preallocate(&self.output, converted);
        let options = RunOptions::new()?.with_outputs(outputs);
        let input = TensorRef::from_array_view((shape, pixels))?;
        let mut outputs = self.session.run_with_options(ort::inputs![input], &options)?;
        outputs
            .remove(&self.output)
            .ok_or_else(|| ort::Error::new("the graph in front of the model has no output"))?
            .downcast()
    }
}

/// The nodes in the order in which they run.
fn graph(format: InputFormat, element: TensorElementType) -> ort::Result<Graph> {
    let mut graph = Graph::new()?;
    let any_size = |shape: [i64; 4], ty| ValueType::Tensor {
        ty,
        shape: Shape::new(shape),
        dimension_symbols: SymbolicDimensions::empty(4),
    };
    let color_axis = match format.layout {
        TensorLayout::Nchw => 1,
        TensorLayout::Nhwc => 3,
    };
    let pixels = any_size([-1, -1, -1, 3], TensorElementType::Uint8);
    graph.set_inputs([Outlet::new(PIXELS, pixels)])?;
    let mut line = Line {
        graph: &mut graph,
        last: PIXELS.to_owned(),
    };
    if format.layout == TensorLayout::Nchw {
        line.add("Transpose", [Attribute::new("perm", vec![0_i64, 3, 1, 2])?])?;
    }
    if format.color_order == ColorOrder::Bgr {
        let order = tensor(&[3], &[2_i64, 1, 0])?;
        let axis = Attribute::new("axis", color_axis as i64)?;
        line.add_with("Gather", "order", order, [axis])?;
    }
    if element != TensorElementType::Uint8 {
        line.cast(TensorElementType::Float32)?;
        let planes = format.planes();
        let mut one_per_color = [1; 4];
        one_per_color[color_axis] = 3;
        let factors = planes.each_ref().map(|plane| plane.conversion.factor);
        if factors != [1.0; 3] {
            line.add_with("Mul", "factors", tensor(&one_per_color, &factors)?, [])?;
        }
        let offsets = planes.map(|plane| plane.conversion.offset);
        if offsets != [0.0; 3] {
            line.add_with("Add", "offsets", tensor(&one_per_color, &offsets)?, [])?;
        }
        if element == TensorElementType::Float16 {
            line.cast(TensorElementType::Float16)?;
        }
    }
    let mut output_shape = [-1; 4];
    output_shape[color_axis] = 3;
    let output = Outlet::new(line.last, any_size(output_shape, element));
    graph.set_outputs([output])?;
    Ok(graph)
}

/// Nodes, each of which takes what the one before it returns.
struct Line<'a> {
    graph: &'a mut Graph,
    /// The output of the last one.
    last: String,
}

impl Line<'_> {
    /// Adds a node.
    fn add(
        &mut self,
        operator: &str,
        attributes: impl IntoIterator<Item = Attribute>,
    ) -> ort::Result<()> {
        let inputs = vec![self.last.clone()];
        self.add_of(operator, inputs, attributes)
    }

    /// Adds a node with a second input, which never changes.
    fn add_with<T: PrimitiveTensorElementType + Debug>(
        &mut self,
        operator: &str,
        name: &str,
        constant: Tensor<T>,
        attributes: impl IntoIterator<Item = Attribute>,
    ) -> ort::Result<()> {
        // Values this small are copied into the graph.
        let is_external = false;
        self.graph.add_initializer(name, constant, is_external)?;
        let inputs = vec![self.last.clone(), name.to_owned()];
        self.add_of(operator, inputs, attributes)
    }

    fn add_of(
        &mut self,
        operator: &str,
        inputs: Vec<String>,
        attributes: impl IntoIterator<Item = Attribute>,
    ) -> ort::Result<()> {
        let output = format!("{}-{}", self.last, operator.to_lowercase());
        let node = Node::new(
            operator,
            ONNX_DOMAIN,
            &output,
            inputs,
            [&output],
            attributes,
        )?;
        self.graph.add_node(node)?;
        self.last = output;
        Ok(())
    }

    fn cast(&mut self, to: TensorElementType) -> ort::Result<()> {
        // Numbers of `TensorProto.DataType` of ONNX.
        let number: i64 = match to {
            TensorElementType::Float16 => 10,
            _ => 1,
        };
        self.add("Cast", [Attribute::new("to", number)?])
    }
}

/// A tensor that a graph can keep: in memory of ONNX Runtime.
fn tensor<T: PrimitiveTensorElementType + Copy + Debug>(
    shape: &[i64],
    values: &[T],
) -> ort::Result<Tensor<T>> {
    let mut tensor = Tensor::<T>::new(&Allocator::default(), Shape::new(shape.iter().copied()))?;
    let (_, elements) = tensor.extract_tensor_mut();
    elements.copy_from_slice(values);
    Ok(tensor)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::onnx::onnxruntime;
    use crate::picture::{Fit, InputElement, InputTensor, Letterbox, Picture, ValueRange};
    use albireo_core::geometry::PictureSize;
    use half::f16;

    const SIZE: PictureSize = PictureSize::new(48, 32);

    /// Two pictures with values from 0 to 255, smaller than the input.
    fn pictures() -> [Picture; 2] {
        [17, 101].map(|step| {
            let mut picture = Picture::black(PictureSize::new(48, 20));
            for (place, value) in picture.pixels.iter_mut().enumerate() {
                *value = (place * step % 256) as u8;
            }
            picture
        })
    }

    fn letterboxed(format: InputFormat) -> Vec<InputTensor> {
        let fill = |picture| {
            let mut letterbox = Letterbox::new(format);
            letterbox.fill(&picture).unwrap();
            letterbox.tensor().clone()
        };
        pictures().map(fill).into()
    }

    fn converted(format: InputFormat, element: &ElementType) -> DynTensor {
        let environment = onnxruntime::environment(None).unwrap();
        let options = Session::builder(&environment).unwrap();
        let memory = |_: &Session| Ok(Allocator::default());
        let mut conversion = PixelConversion::open(format, element, &options, memory).unwrap();
        let mut pixels = Vec::new();
        for tensor in letterboxed(format.as_pixels()) {
            match tensor {
                InputTensor::Bytes(bytes) => pixels.extend(bytes),
                InputTensor::Floats(_) => panic!("pixels are bytes"),
            }
        }
        let mut shape = format.as_pixels().shape();
        shape[0] = pictures().len() as i64;
        conversion.run(shape, &pixels).unwrap()
    }

    fn floats(format: InputFormat) -> Vec<f32> {
        letterboxed(format)
            .iter()
            .flat_map(|tensor| tensor.to_floats().into_owned())
            .collect()
    }

    fn formats_of_floats() -> Vec<InputFormat> {
        let mut formats = Vec::new();
        for layout in [TensorLayout::Nchw, TensorLayout::Nhwc] {
            for color_order in [ColorOrder::Rgb, ColorOrder::Bgr] {
                for value_range in [ValueRange::To255, ValueRange::ToOne, ValueRange::ImageNet] {
                    formats.push(InputFormat {
                        size: SIZE,
                        fit: Fit::Centre,
                        color_order,
                        value_range,
                        layout,
                        element: InputElement::Float,
                    });
                }
            }
        }
        formats
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn the_graph_makes_the_very_numbers_that_the_letterbox_makes() {
        for format in formats_of_floats() {
            let found = converted(format, &ElementType::Float32);
            let (shape, values) = found.try_extract_tensor::<f32>().unwrap();
            assert_eq!(shape[1..], format.shape()[1..], "{format:?}");
            assert!(values == floats(format), "{format:?}");
        }
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn for_a_model_in_half_precision_the_graph_rounds_the_numbers_of_the_letterbox() {
        for format in formats_of_floats() {
            let found = converted(format, &ElementType::Float16);
            let (_, halves) = found.try_extract_tensor::<f16>().unwrap();
            let expected: Vec<f16> = floats(format).into_iter().map(f16::from_f32).collect();
            assert!(halves == expected, "{format:?}");
        }
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn a_model_that_takes_bytes_gets_them_in_its_layout_and_order() {
        let format = InputFormat {
            size: SIZE,
            fit: Fit::TopLeft,
            color_order: ColorOrder::Bgr,
            value_range: ValueRange::To255,
            layout: TensorLayout::Nchw,
            element: InputElement::Byte,
        };
        let found = converted(format, &ElementType::Uint8);
        let (_, bytes) = found.try_extract_tensor::<u8>().unwrap();
        assert!(bytes.iter().copied().map(f32::from).eq(floats(format)));
    }
}

//! Writes small ONNX files from numbers: a graph whose outputs are constants, so that every box in them is known. The
//! fields are those of `onnx.proto` (ONNX 1.16), by number.

use std::path::{Path, PathBuf};

/// The numbers of an output.
#[derive(Clone, Debug)]
pub(crate) enum Numbers {
    Floats(Vec<f32>),
    Whole { element: u64, values: Vec<i64> },
}

/// An input, whose elements are of a type of `onnx.proto`.
#[derive(Clone, Debug)]
struct PlantedInput {
    name: &'static str,
    shape: Vec<i64>,
    element: u64,
}

#[derive(Clone, Debug)]
struct PlantedOutput {
    name: &'static str,
    /// The dimensions in the model's signature; -1 for one that is declared open.
    declared: Vec<i64>,
    shape: Vec<i64>,
    numbers: Numbers,
}

/// A model of constants.
#[derive(Clone, Debug, Default)]
pub(crate) struct Planted {
    /// The picture, and what some models have beside it.
    inputs: Vec<PlantedInput>,
    outputs: Vec<PlantedOutput>,
    metadata: Vec<(&'static str, String)>,
}

pub(crate) const FLOAT: u64 = 1;
pub(crate) const UINT8: u64 = 2;
pub(crate) const INT8: u64 = 3;
pub(crate) const UINT16: u64 = 4;
pub(crate) const INT16: u64 = 5;
pub(crate) const INT32: u64 = 6;
pub(crate) const INT64: u64 = 7;
pub(crate) const UINT32: u64 = 12;

impl Planted {
    pub(crate) fn input(self, name: &'static str, shape: &[i64]) -> Self {
        self.input_of(FLOAT, name, shape)
    }

    pub(crate) fn bytes_input(self, name: &'static str, shape: &[i64]) -> Self {
        self.input_of(UINT8, name, shape)
    }

    pub(crate) fn whole_input(self, name: &'static str, shape: &[i64]) -> Self {
        self.input_of(INT64, name, shape)
    }

    pub(crate) fn input_of(mut self, element: u64, name: &'static str, shape: &[i64]) -> Self {
        self.inputs.push(PlantedInput {
            name,
            shape: shape.to_vec(),
            element,
        });
        self
    }

    /// An output that is declared with `declared` and has `shape`, in which all numbers but those at the given places are
    /// `rest`.
    pub(crate) fn output(
        mut self,
        name: &'static str,
        declared: &[i64],
        shape: &[i64],
        rest: f32,
        places: &[(usize, f32)],
    ) -> Self {
        let mut values = vec![rest; shape.iter().product::<i64>() as usize];
        for &(place, value) in places {
            values[place] = value;
        }
        self.outputs.push(PlantedOutput {
            name,
            declared: declared.to_vec(),
            shape: shape.to_vec(),
            numbers: Numbers::Floats(values),
        });
        self
    }

    pub(crate) fn whole_output(self, name: &'static str, shape: &[i64], first: i64) -> Self {
        self.output_of(INT64, name, shape, first)
    }

    /// An output of whole numbers, all 0 but the first.
    pub(crate) fn output_of(
        mut self,
        element: u64,
        name: &'static str,
        shape: &[i64],
        first: i64,
    ) -> Self {
        let mut values = vec![0; shape.iter().product::<i64>() as usize];
        values[0] = first;
        self.outputs.push(PlantedOutput {
            name,
            declared: shape.to_vec(),
            shape: shape.to_vec(),
            numbers: Numbers::Whole { element, values },
        });
        self
    }

    pub(crate) fn entry(mut self, key: &'static str, value: &str) -> Self {
        self.metadata.push((key, value.to_owned()));
        self
    }

    /// Writes the file into `folder`.
    pub(crate) fn write(&self, folder: &Path) -> PathBuf {
        let mut graph = Message::default();
        for output in &self.outputs {
            let mut node = Message::default();
            node.text(1, &output.constant()).text(2, output.name).text(4, "Identity");
            graph.message(1, &node);
        }
        graph.text(2, "planted");
        for output in &self.outputs {
            let constant = tensor(&output.constant(), &output.shape, &output.numbers);
            graph.message(5, &constant);
        }
        for input in &self.inputs {
            let info = value_info(input.name, input.element, &input.shape);
            graph.message(11, &info);
        }
        for output in &self.outputs {
            let element = match output.numbers {
                Numbers::Floats(_) => FLOAT,
                Numbers::Whole { element, .. } => element,
            };
            let info = value_info(output.name, element, &output.declared);
            graph.message(12, &info);
        }
        let mut opset = Message::default();
        opset.text(1, "").number(2, 17);
        let mut model = Message::default();
        model.number(1, 8).message(7, &graph).message(8, &opset);
        for (key, value) in &self.metadata {
            let mut entry = Message::default();
            entry.text(1, key).text(2, value);
            model.message(14, &entry);
        }
        let file = folder.join("model.onnx");
        std::fs::write(&file, &model.0).unwrap();
        file
    }
}

impl PlantedOutput {
    /// The name of the constant that it gives.
    fn constant(&self) -> String {
        format!("planted_{}", self.name)
    }
}

fn tensor(name: &str, shape: &[i64], numbers: &Numbers) -> Message {
    let mut tensor = Message::default();
    for &side in shape {
        tensor.number(1, side as u64);
    }
    let (element, bytes): (u64, Vec<u8>) = match numbers {
        Numbers::Floats(values) => {
            let bytes = values.iter().flat_map(|value| value.to_le_bytes());
            (FLOAT, bytes.collect())
        }
        Numbers::Whole { element, values } => {
            let width = match *element {
                UINT8 | INT8 => 1,
                UINT16 | INT16 => 2,
                INT32 | UINT32 => 4,
                _ => 8,
            };
            let bytes = values.iter().flat_map(|value| value.to_le_bytes().into_iter().take(width));
            (*element, bytes.collect())
        }
    };
    tensor.number(2, element).text(8, name).bytes(9, &bytes);
    tensor
}

fn value_info(name: &str, element: u64, shape: &[i64]) -> Message {
    let mut sides = Message::default();
    for (place, &side) in shape.iter().enumerate() {
        let mut dimension = Message::default();
        match side {
            -1 => dimension.text(2, &format!("open{place}")),
            side => dimension.number(1, side as u64),
        };
        sides.message(1, &dimension);
    }
    let mut tensor_type = Message::default();
    tensor_type.number(1, element).message(2, &sides);
    let mut kind = Message::default();
    kind.message(1, &tensor_type);
    let mut info = Message::default();
    info.text(1, name).message(2, &kind);
    info
}

/// A message of protocol buffers that is being written.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn number(&mut self, field: u64, value: u64) -> &mut Self {
        self.varint(field << 3);
        self.varint(value);
        self
    }

    fn bytes(&mut self, field: u64, bytes: &[u8]) -> &mut Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
        self
    }

    fn text(&mut self, field: u64, text: &str) -> &mut Self {
        self.bytes(field, text.as_bytes())
    }

    fn message(&mut self, field: u64, message: &Self) -> &mut Self {
        self.bytes(field, &message.0)
    }
}

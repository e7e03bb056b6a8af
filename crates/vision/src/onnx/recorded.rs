//! Runs whose tensors stay where they are: CUDA records what such a run does, and from then on the processor starts it in
//! one call instead of layer by layer (a CUDA graph).

use ort::memory::Allocator;
use ort::session::{IoBinding, RunOptions, Session};
use ort::value::{DynTensor, DynValue, TensorElementType};
use std::collections::{HashMap, HashSet};
use tracing::warn;

/// The run option with the number of a graph (`onnxruntime_run_options_config_keys.h`).
const GRAPH: &str = "gpu_graph_id";

/// Returns the options of a run that is neither recorded nor replayed.
pub(super) fn unrecorded() -> ort::Result<RunOptions> {
    options("-1")
}

fn options(graph: &str) -> ort::Result<RunOptions> {
    let mut options = RunOptions::new()?;
    options.set(GRAPH, graph)?;
    Ok(options)
}

/// The recorded runs of a session, by the shape of their pictures.
pub(super) struct RecordedRuns {
    /// Memory of the device that runs the model.
    memory: Allocator,
    runs: HashMap<[i64; 4], RecordedRun>,
    /// The other shapes of which the log was told.
    warned_of: HashSet<[i64; 4]>,
}

/// One input or output of a model.
pub(super) struct TensorShape {
    pub name: String,
    pub element: TensorElementType,
    pub shape: Vec<i64>,
}

impl RecordedRuns {
    pub(super) fn new(memory: Allocator) -> Self {
        Self {
            memory,
            runs: HashMap::new(),
            warned_of: HashSet::new(),
        }
    }

    /// The recorded run for pictures of `shape`.
    pub(super) fn of(&mut self, shape: [i64; 4]) -> Option<&mut RecordedRun> {
        self.runs.get_mut(&shape)
    }

    /// Warns, once for each shape, of pixels of `shape` whose run was not recorded. Before the first recording nothing is
    /// missing yet.
    pub(super) fn warn_of(&mut self, shape: [i64; 4]) {
        if self.runs.is_empty() || !self.warned_of.insert(shape) {
            return;
        }
        let [pictures, rows, columns, _] = shape;
        warn!(
            pictures,
            rows,
            columns,
            "CUDA recorded no run of this shape at the start: the processor starts such runs layer by layer, as without \
             detector.gpu.cuda_graph"
        );
    }

    /// Lays out the tensors of a run for pictures of `shape`; `beside` are the other inputs, by name, the same in each
    /// run. Returns that run, which its first replay records.
    pub(super) fn add(
        &mut self,
        session: &Session,
        shape: [i64; 4],
        picture: &TensorShape,
        beside: &[(String, DynValue)],
        outputs: Vec<TensorShape>,
    ) -> ort::Result<&mut RecordedRun> {
        let input = self.tensor(picture)?;
        let mut binding = session.create_binding()?;
        binding.bind_input(&picture.name, &input)?;
        for (name, value) in beside {
            binding.bind_input(name, value)?;
        }
        let mut bound = Vec::with_capacity(outputs.len());
        for output in outputs {
            let mut there = self.tensor(&output)?;
            binding.bind_output(output.name, &mut there)?;
            let here = DynTensor::new(&Allocator::default(), output.element, output.shape)?;
            bound.push(RecordedOutput { there, here });
        }
        // Number 0 is ONNX Runtime's own.
        let graph = self.runs.len() + 1;
        let run = RecordedRun {
            input,
            binding,
            options: options(&graph.to_string())?,
            outputs: bound,
        };
        Ok(self.runs.entry(shape).insert_entry(run).into_mut())
    }

    fn tensor(&self, of: &TensorShape) -> ort::Result<DynTensor> {
        DynTensor::new(&self.memory, of.element, of.shape.as_slice())
    }
}

/// A run with its tensors.
pub(super) struct RecordedRun {
    input: DynTensor,
    binding: IoBinding,
    options: RunOptions,
    outputs: Vec<RecordedOutput>,
}

/// An output where the model runs, and its copy in the processor's memory.
struct RecordedOutput {
    there: DynTensor,
    here: DynTensor,
}

impl RecordedRun {
    /// Runs the model on `pictures`, which lie where it runs.
    pub(super) fn replay(
        &mut self,
        session: &mut Session,
        pictures: &DynTensor,
    ) -> ort::Result<()> {
        pictures.copy_into(&mut self.input)?;
        session.run_binding_with_options(&self.binding, &self.options)?;
        for output in &mut self.outputs {
            output.there.copy_into(&mut output.here)?;
        }
        Ok(())
    }

    /// Returns the outputs of the last run, in the processor's memory and in the model's order.
    pub(super) fn outputs(&self) -> impl Iterator<Item = &DynTensor> {
        self.outputs.iter().map(|output| &output.here)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::onnx::onnxruntime;
    use ort::editor::{Graph, Model, Node, ONNX_DOMAIN, Opset};
    use ort::value::{Outlet, Shape, SymbolicDimensions, Tensor, ValueType};

    /// A model that multiplies its picture by two numbers beside it.
    fn session() -> Session {
        let outlet = |name, shape: &[i64]| {
            let ty = ValueType::Tensor {
                ty: TensorElementType::Float32,
                shape: Shape::new(shape.iter().copied()),
                dimension_symbols: SymbolicDimensions::empty(shape.len()),
            };
            Outlet::new(name, ty)
        };
        let mut graph = Graph::new().unwrap();
        let inputs = [
            outlet("numbers", &[1, 2]),
            outlet("picture", &[1, 1, -1, 2]),
        ];
        graph.set_inputs(inputs).unwrap();
        let node = Node::new(
            "Mul",
            ONNX_DOMAIN,
            "product",
            ["picture", "numbers"],
            ["out"],
            [],
        );
        graph.add_node(node.unwrap()).unwrap();
        graph.set_outputs([outlet("out", &[1, 1, -1, 2])]).unwrap();
        let mut model = Model::new([Opset::new(ONNX_DOMAIN, 17).unwrap()]).unwrap();
        model.set_graph(graph).unwrap();
        let environment = onnxruntime::environment(None).unwrap();
        model.into_session(&Session::builder(&environment).unwrap()).unwrap()
    }

    #[test]
    #[ignore = "needs ONNX Runtime"]
    fn runs_of_several_shapes_each_keep_their_numbers_and_take_new_pictures() {
        let mut session = session();
        let mut runs = RecordedRuns::new(Allocator::default());
        for (rows, factor) in [(1, 10.0_f32), (2, 100.0)] {
            let shape = [1, 1, rows, 2];
            let tensor = |name: &str| TensorShape {
                name: name.to_owned(),
                element: TensorElementType::Float32,
                shape: shape.to_vec(),
            };
            let numbers = Tensor::from_array(([1, 2], vec![factor, -factor])).unwrap();
            let beside = vec![("numbers".to_owned(), numbers.into_dyn())];
            let outputs = vec![tensor("out")];
            runs.add(&session, shape, &tensor("picture"), &beside, outputs).unwrap();
        }
        for (values, expected) in [
            (vec![1.0_f32, 2.0], vec![10.0, -20.0]),
            (vec![1.0, 2.0, 3.0, 4.0], vec![100.0, -200.0, 300.0, -400.0]),
            (vec![5.0, 6.0], vec![50.0, -60.0]),
        ] {
            let shape = [1, 1, values.len() as i64 / 2, 2];
            let picture = Tensor::from_array((shape, values)).unwrap().upcast();
            let run = runs.of(shape).unwrap();
            run.replay(&mut session, &picture).unwrap();
            let [output] = run.outputs().collect::<Vec<_>>()[..] else {
                panic!("not one output");
            };
            let (_, product) = output.try_extract_tensor::<f32>().unwrap();
            assert_eq!(product, expected);
        }
        assert!(runs.of([1, 1, 3, 2]).is_none());
    }
}

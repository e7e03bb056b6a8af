//! The extension module of the Python package `albireo`: a policy of the core behind NumPy arrays.
//!
//! The Python code checks arguments and has the types of results; this module only handles boxes as arrays.

mod boxes;
mod decider;
mod grey;
mod order;
mod settled;

use pyo3::prelude::*;

/// The extension module `albireo._core`.
#[pymodule(gil_used = false)]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<decider::Decider>()?;
    module.add("SOURCES", boxes::SOURCES)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}

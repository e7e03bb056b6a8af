//! Errors of starting a session and of running it.

use std::path::PathBuf;

/// Why a model could not be started. Every message says what to do.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// No ONNX Runtime library anywhere.
    #[error(
        "no ONNX Runtime library was found; looked at {}. Run `make onnxruntime`, or name the library in \
         detector.onnxruntime or ORT_DYLIB_PATH",
        looked_at.join(", ")
    )]
    LibraryNotFound {
        /// The places, in the order they were looked at.
        looked_at: Vec<String>,
    },
    /// The library is there and cannot be used.
    #[error("the ONNX Runtime library {} cannot be used: {reason}; version 1.22 or newer is needed", path.display())]
    LibraryUnusable {
        /// The library.
        path: PathBuf,
        /// The message of the loader.
        reason: String,
    },
    /// The ONNX file is missing, damaged or not supported by this ONNX Runtime.
    #[error("the model {} cannot be loaded: {reason}", path.display())]
    ModelUnreadable {
        /// The ONNX file.
        path: PathBuf,
        /// The message of ONNX Runtime or the file system.
        reason: String,
    },
    /// The model is sound and its inputs or outputs are not what the head reads.
    #[error(
        "the model {} does not fit the head `{head}`: {reason}. The model has {model}; the head expects \
         {expected}. Choose the head that belongs to the model, or export the model as the head expects it",
        path.display()
    )]
    ModelDoesNotFit {
        /// The ONNX file.
        path: PathBuf,
        /// The configured head.
        head: &'static str,
        /// Inputs and outputs of the model with their shapes.
        model: String,
        /// Inputs and outputs the head expects.
        expected: String,
        /// The first thing that differs.
        reason: String,
    },
    /// The model is sound and none of the heads is known to read it.
    #[error(
        "the model {} is not recognised: {reason}. The model has {model}. Looked for {}. If you know how it is to \
         be read, name the head in detector.head",
        path.display(),
        looked_for.join("; ")
    )]
    ModelNotRecognised {
        /// The ONNX file.
        path: PathBuf,
        /// What is the matter.
        reason: String,
        /// Inputs and outputs of the model with their shapes.
        model: String,
        /// The heads that were looked for, and why it is none of them.
        looked_for: Vec<String>,
    },
    /// An execution provider that was asked for does not work here.
    #[error(
        "the execution provider `{provider}` does not work here: {reason}. Install what it needs, or list \
         another in detector.providers"
    )]
    ProviderUnavailable {
        /// The provider as named in the configuration.
        provider: &'static str,
        /// The message of ONNX Runtime.
        reason: String,
    },
    /// The configuration contradicts itself or the model.
    #[error("{key}: {reason}")]
    Configuration {
        /// The key of the configuration.
        key: String,
        /// What is wrong with its value and what would be right.
        reason: String,
    },
    /// The file was replaced by a model with other classes or another input while the program runs.
    #[error(
        "the model of the {task} has other classes or another input than when the program started; start the program \
         again to use the new file"
    )]
    ModelChanged {
        /// Which task.
        task: &'static str,
    },
    /// The model was loaded and its first run failed.
    #[error("the first run of the model {} failed: {reason}", path.display())]
    WarmUp {
        /// The ONNX file.
        path: PathBuf,
        /// The error of the run.
        reason: String,
    },
    /// The thread that was to build the session could not be started, or panicked.
    #[error("the thread of the {task} failed while it was starting: {reason}")]
    Thread {
        /// Which task.
        task: &'static str,
        /// The system's error or the panic's message.
        reason: String,
    },
}

/// Why a picture was not answered. The frame it belongs to can be answered from prediction.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InferenceError {
    /// The picture cannot be answered; the session is as good as before.
    #[error("the picture cannot be used: {0}")]
    BadPicture(String),
    /// The run took too long; no other begins until it has come back.
    #[error("the run took longer than {timeout_ms} ms")]
    TimedOut {
        /// The limit.
        timeout_ms: u64,
    },
    /// The run ended with an error; the session is rebuilt.
    #[error("the run failed: {0}")]
    Failed(String),
    /// What was found in this run and in those before it is impossible.
    #[error("{0}")]
    Implausible(String),
    /// The run panicked; the session is rebuilt.
    #[error("the run panicked: {0}")]
    Panicked(String),
    /// No session can take pictures now: it is being rebuilt after a failure, or a run takes too long.
    #[error("no session can take pictures now: {0}")]
    Unavailable(String),
    /// The worker has been stopped.
    #[error("the worker has been stopped")]
    Stopped,
}

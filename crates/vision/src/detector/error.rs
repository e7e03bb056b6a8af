//! Errors of starting a session and of running it.

use std::path::PathBuf;

/// The reason why a model could not be started. Every message names a remedy.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// No ONNX Runtime library was found.
    #[error(
        "no ONNX Runtime library was found; looked at {}. Run `make onnxruntime`, or name the library in \
         detector.onnxruntime or ORT_DYLIB_PATH",
        looked_at.join(", ")
    )]
    LibraryNotFound {
        /// The places searched, in order.
        looked_at: Vec<String>,
    },
    /// The library exists but cannot be used.
    #[error("the ONNX Runtime library {} cannot be used: {reason}; version 1.22 or newer is needed", path.display())]
    LibraryUnusable {
        /// The library.
        path: PathBuf,
        /// The loader's message.
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
    /// The model is sound, but its inputs or outputs are not what the head reads.
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
        /// The model's inputs and outputs with their shapes.
        model: String,
        /// The inputs and outputs that the head expects.
        expected: String,
        /// The first difference.
        reason: String,
    },
    /// The model is sound, but none of the heads is known to read it.
    #[error(
        "the model {} is not recognised: {reason}. The model has {model}. Looked for {}. If you know how to read \
         it, set detector.head",
        path.display(),
        looked_for.join("; ")
    )]
    ModelNotRecognised {
        /// The ONNX file.
        path: PathBuf,
        /// The reason.
        reason: String,
        /// The model's inputs and outputs with their shapes.
        model: String,
        /// The heads that were tried, and why each does not fit.
        looked_for: Vec<String>,
    },
    /// A configured execution provider does not work here.
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
        /// The configuration key.
        key: String,
        /// The problem with its value, and the remedy.
        reason: String,
    },
    /// The file was replaced by a model with other classes or another input while the program was running.
    #[error(
        "the model of the {task} has other classes or another input than when the program started; restart the program \
         to use the new file"
    )]
    ModelChanged {
        /// The name of the task.
        task: &'static str,
    },
    /// The model was loaded, but its first run failed.
    #[error("the first run of the model {} failed: {reason}", path.display())]
    WarmUp {
        /// The ONNX file.
        path: PathBuf,
        /// The error of the run.
        reason: String,
    },
    /// The thread that builds the session could not be started, or panicked.
    #[error("the thread of the {task} failed while it was starting: {reason}")]
    Thread {
        /// The name of the task.
        task: &'static str,
        /// The system's error or the panic's message.
        reason: String,
    },
}

/// The reason why a picture was not answered. Its frame can be answered from prediction.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InferenceError {
    /// The picture cannot be answered; the session is unaffected.
    #[error("the picture cannot be used: {0}")]
    BadPicture(String),
    /// The run took too long; no other run begins until it has come back.
    #[error("the run took longer than {timeout_ms} ms")]
    TimedOut {
        /// The time limit.
        timeout_ms: u64,
    },
    /// The run ended with an error; the session is rebuilt.
    #[error("the run failed: {0}")]
    Failed(String),
    /// The results of this run and of those before it are impossible.
    #[error("{0}")]
    Implausible(String),
    /// The run panicked; the session is rebuilt.
    #[error("the run panicked: {0}")]
    Panicked(String),
    /// No session can accept pictures now: it is being rebuilt after a failure, or a run takes too long.
    #[error("no session can accept pictures now: {0}")]
    Unavailable(String),
    /// The worker has been stopped.
    #[error("the worker has been stopped")]
    Stopped,
}

//! The thread on which a model is built, run and dropped.

use super::{Model, RunError};
use crate::onnx::{ExecutionProvider, StartError, StartErrorKind};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender, channel};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// A command to the thread.
pub(super) enum Command<I> {
    /// Build the model; none exists.
    Build,
    /// Run it on these pictures.
    Run(Vec<I>),
}

/// The result of a command.
pub(super) enum Outcome<M: Model> {
    /// The provider that runs the model, and the facts that its users rely on.
    Built(Result<(ExecutionProvider, M::Facts), StartError>),
    /// One output per picture. After any error but [`RunError::Implausible`] the model is gone.
    Ran(Result<Vec<M::Output>, RunError>),
}

/// The ends of the thread's two channels; the thread exits when `commands` is dropped.
pub(super) struct ModelThread<M: Model> {
    pub(super) commands: Sender<Command<M::Input>>,
    pub(super) outcomes: UnboundedReceiver<Outcome<M>>,
}

impl<M: Model> ModelThread<M> {
    pub(super) fn spawn(
        name: &'static str,
        build: impl Fn() -> Result<M, StartError> + Send + 'static,
    ) -> std::io::Result<Self> {
        let (commands, received) = channel();
        let (sender, outcomes) = unbounded_channel();
        std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || work(name, &build, &received, &sender))?;
        Ok(Self { commands, outcomes })
    }
}

fn work<M: Model>(
    name: &'static str,
    build: &dyn Fn() -> Result<M, StartError>,
    commands: &Receiver<Command<M::Input>>,
    outcomes: &UnboundedSender<Outcome<M>>,
) {
    let mut model: Option<M> = None;
    let mut first_facts: Option<M::Facts> = None;
    while let Ok(command) = commands.recv() {
        let outcome = match command {
            Command::Build => {
                let built = catch_unwind(AssertUnwindSafe(build))
                    .unwrap_or_else(|panic| Err(StartError::thread(name, message(&*panic))))
                    .and_then(|built| checked(name, built, first_facts.as_ref()));
                match built {
                    Ok(built) => {
                        let provider = built.provider();
                        let facts = built.facts();
                        if first_facts.is_none() {
                            first_facts = Some(facts.clone());
                        }
                        model = Some(built);
                        Outcome::Built(Ok((provider, facts)))
                    }
                    Err(error) => Outcome::Built(Err(error)),
                }
            }
            Command::Run(pictures) => {
                let ran = catch_unwind(AssertUnwindSafe(|| run(&mut model, &pictures)))
                    .unwrap_or_else(|panic| Err(RunError::Panicked(message(&*panic))));
                // Before the answer is sent, so that the asker can reuse the buffers.
                drop(pictures);
                if let Err(error) = &ran
                    && !matches!(error, RunError::Implausible(_))
                {
                    // Its memory must be free before a new model is built: a GPU may not have room for two.
                    let failed = model.take();
                    let _ = catch_unwind(AssertUnwindSafe(move || drop(failed)));
                }
                Outcome::Ran(ran)
            }
        };
        if outcomes.send(outcome).is_err() {
            return;
        }
    }
}

/// The model, if it has the facts of the first that was built.
fn checked<M: Model>(
    name: &str,
    built: M,
    first_facts: Option<&M::Facts>,
) -> Result<M, StartError> {
    if first_facts.is_none_or(|first| *first == built.facts()) {
        return Ok(built);
    }
    Err(StartError::new(
        StartErrorKind::DoesNotFit,
        format_args!(
            "the model of the {name} has other classes or another input than when the program started; restart the \
             program to use the new file"
        ),
    ))
}

fn run<M: Model>(model: &mut Option<M>, pictures: &[M::Input]) -> Result<Vec<M::Output>, RunError> {
    let Some(model) = model else {
        return Err(RunError::Failed("there is no model".to_owned()));
    };
    match model.run(pictures) {
        Ok(outputs) if outputs.len() == pictures.len() => Ok(outputs),
        Ok(outputs) => Err(RunError::Failed(format!(
            "the model answered {} of {} pictures",
            outputs.len(),
            pictures.len()
        ))),
        Err(error) => Err(error),
    }
}

/// The message of a panic.
fn message(panic: &(dyn Any + Send)) -> String {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message")
        .to_owned()
}

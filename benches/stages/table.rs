//! Prints the table, in 80 columns.

use super::samples::{Samples, Stage};

/// The model time behind the goal: albireo's own stages take at most a tenth of its 10 ms.
const MODEL_MS: f64 = 10.0;

/// Prints a line per stage, and the sum of albireo's own stages.
pub(crate) fn print(ours: &Samples, python: Option<&Samples>) {
    let model = ours.stage(Stage::Model).map(|[model, _]| model);
    let header = format!(
        "{:<25}{:>8}{:>8}{:>11}{:>11}",
        "milliseconds", "median", "95 %", "of model", "of 10 ms"
    );
    match python {
        Some(_) => println!("{header}{:>8}{:>8}", "Python", "95 %"),
        None => println!("{header}"),
    }
    for stage in Stage::ALL {
        let Some(times) = ours.stage(stage) else {
            continue;
        };
        let mut line = beginning(stage.title(), times);
        match stage {
            Stage::Decode | Stage::Model => line += &" ".repeat(22),
            _ => line += &shares(times, model),
        }
        if let Some([median, late]) = python.and_then(|python| python.stage(stage)) {
            line += &format!("{median:>8.3}{late:>8.3}");
        }
        println!("{}", line.trim_end());
    }
    if let Some(times) = ours.ours() {
        println!(
            "{}{}",
            beginning("ours, without decoding", times),
            shares(times, model)
        );
    }
}

fn beginning(title: &str, [median, late]: [f64; 2]) -> String {
    format!("{title:<25}{median:>8.3}{late:>8.3}")
}

/// The shares of the model's median, if there is one, and of the 10 ms, in 22 columns.
fn shares([median, _]: [f64; 2], model: Option<f64>) -> String {
    let of_goal = format!("{:>9.1} %", median / MODEL_MS * 100.0);
    match model {
        Some(model) => format!("{:>9.1} %{of_goal}", median / model * 100.0),
        None => format!("{:11}{of_goal}", ""),
    }
}

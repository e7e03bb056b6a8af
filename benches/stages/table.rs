//! Prints the table, in 80 columns.

use super::samples::{Samples, Stage};

/// The model time behind the goal: albireo's own stages take at most a tenth of its 10 ms.
const MODEL_MS: f64 = 10.0;

/// Prints a line per stage, and the sum of albireo's own stages.
pub(crate) fn print(ours: &Samples, python: Option<&Samples>) {
    let model = ours.of(Stage::Model);
    let line = |title: &str, times: Option<[f64; 2]>, theirs: Option<[f64; 2]>, share: bool| {
        let Some([median, late]) = times else { return };
        let mut text = format!("{title:<25}{median:>8.3}{late:>8.3}");
        let shares = [
            model.map(|[model, _]| median / model),
            Some(median / MODEL_MS),
        ];
        for value in shares {
            text += &match value.filter(|_| share) {
                Some(value) => format!("{:>9.1} %", value * 100.0),
                None => " ".repeat(11),
            };
        }
        if let Some([median, late]) = theirs {
            text += &format!("{median:>8.3}{late:>8.3}");
        }
        println!("{}", text.trim_end());
    };
    let header = format!(
        "{:<25}{:>8}{:>8}{:>11}{:>11}",
        "milliseconds", "median", "95 %", "of model", "of 10 ms"
    );
    match python {
        Some(_) => println!("{header}{:>8}{:>8}", "Python", "95 %"),
        None => println!("{header}"),
    }
    for stage in Stage::ALL {
        let theirs = python.and_then(|python| python.of(stage));
        let share = stage != Stage::Decode && stage != Stage::Model;
        line(stage.title(), ours.of(stage), theirs, share);
    }
    line("ours, without decoding", ours.ours(), None, true);
}

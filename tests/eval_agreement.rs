//! The evaluation gives the figures of the published evaluator on the same boxes.

use crate::support::shared;
use albireo_core::policy::{PolicyConfig, Profile};
use albireo_eval::average_precision::{Classes, Interpolation};
use albireo_eval::data::recorded;
use albireo_eval::run::{Settings, run};
use albireo_eval::source::ScreenRule;
use albireo_eval::spec::resolve;
use std::collections::HashMap;

/// `summary.csv` of the published code: figures by sequence, policy and column.
fn golden_summary() -> HashMap<(String, String), HashMap<String, f64>> {
    let mut reader =
        csv::Reader::from_path(shared("golden/summary.csv")).expect("the summary is there");
    let headers = reader.headers().expect("it has a header").clone();
    reader
        .records()
        .map(|record| {
            let record = record.expect("a readable row");
            let figures = headers
                .iter()
                .zip(record.iter())
                .filter_map(|(name, value)| Some((name.to_owned(), value.parse().ok()?)))
                .collect();
            ((record[0].to_owned(), record[4].to_owned()), figures)
        })
        .collect()
}

#[test]
#[ignore = "needs ../shared"]
fn shared_every_policy_of_the_published_summary_gives_the_published_figures() {
    let summary = golden_summary();
    let clips = recorded::read(&shared("data/recorded")).expect("the recordings");
    let mut compared = 0;
    for screen in [ScreenRule::Nonempty, ScreenRule::Detections] {
        let base = PolicyConfig {
            profile: Profile::Reference,
            ..PolicyConfig::default()
        };
        let asked = "albireo:3e-4 albireo:5e-4 albireo:7e-4 albireo:1e-3 fixed-skip:2 fixed-skip:3 fixed-skip:5 \
                     ctd:0.30 ctd:0.50 ctd:0.70 ctd:0.90";
        let asked: Vec<_> = asked.split_whitespace().map(str::to_owned).collect();
        let policies = resolve(&asked, &[], &base, screen, false).expect("known policies");
        let settings = Settings {
            profile: Profile::Reference,
            confidence: 0.5,
            screen,
            classes: Classes::Pooled,
            interpolation: Interpolation::AllPoints,
            ..Settings::default()
        };
        let results = run(&clips.clips, &policies, &settings, &|| ()).expect("it runs");
        for result in results {
            let expected = &summary[&(result.clip.clone(), result.policy.clone())];
            let [e, p, ei, i, ai] = result.state_shares();
            let mut figures = vec![
                ("skip_rate", result.skip_rate()),
                ("share_E", e),
                ("share_P", p),
                ("share_EI", ei),
                ("share_I", i),
                ("share_AI", ai),
                ("boxes", result.boxes as f64),
            ];
            let has_truth = expected.contains_key("ap50_decayed");
            assert_eq!(result.accuracy.is_some(), has_truth, "{}", result.clip);
            if let (Some(decayed), Some(last)) = (result.accuracy, result.accuracy_last_confidence)
            {
                figures.extend([
                    ("ap50_decayed", decayed.ap50),
                    ("map_decayed", decayed.map),
                    ("ap50_lastconf", last.ap50),
                    ("map_lastconf", last.map),
                ]);
            }
            for (name, value) in figures {
                let (what, published) =
                    (format!("{} {}", result.policy, result.clip), expected[name]);
                let off = (value - published).abs();
                assert!(
                    off < 1e-6,
                    "{what} {name}: {value}, published code {published}"
                );
                compared += 1;
            }
        }
    }
    // Two screens, vanilla and eleven others, 17 clips with accuracy and 4 without.
    assert_eq!(compared, 2 * 12 * (17 * 11 + 4 * 7));
}

//! The evaluation gives the figures of the published evaluator on the same boxes.

use crate::support::shared;
use albireo_core::policy::{PolicyConfig, Profile};
use albireo_eval::data::recorded;
use albireo_eval::judge::{Classes, Interpolation};
use albireo_eval::run::run;
use albireo_eval::settings::ScreenRule;
use albireo_eval::settings::Settings;
use albireo_eval::spec::resolve;
use std::collections::HashMap;

type Row = HashMap<String, String>;

#[test]
#[ignore = "needs ../shared"]
fn shared_every_policy_of_the_published_summary_gives_the_published_figures() {
    // The rows of the published code's summary by sequence and policy.
    let mut summary = HashMap::new();
    let reader = csv::Reader::from_path(shared("golden/summary.csv"));
    for row in reader.expect("the summary").into_deserialize::<Row>() {
        let row = row.expect("a readable row");
        // The published name has no hyphen.
        let policy = row["policy"].replace("fixedskip", "fixed-skip");
        summary.insert((row["sequence"].clone(), policy), row);
    }
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
        for result in run(&clips.clips, &policies, &settings, &|| ()).expect("it runs") {
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
            let has_truth = expected["ap50_decayed"].parse::<f64>().is_ok();
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
                let what = format!("{name}, {} on {}", result.policy, result.clip);
                let published: f64 = expected[name].parse().expect("a number");
                let off = (value - published).abs();
                assert!(off < 1e-6, "{what}: {value}, published {published}");
                compared += 1;
            }
        }
    }
    // Two screens, vanilla and eleven others, 17 clips with accuracy and 4 without.
    assert_eq!(compared, 2 * 12 * (17 * 11 + 4 * 7));
}

//! Measures how many cameras one detector carries at 30 frames per second under each policy, with the energy of each.

use super::arguments::{Arguments, name_of, without_folder};
use super::card::{Card, Energy};
use super::node::{Answer, Node, RATE, Settings, batch};
use super::page::{NONE, Page, ms, percentile};
use albireo_vision::detector::DetectorConfig;
use albireo_vision::picture::EncodedPicture;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

const POLICIES: [&str; 3] = ["vanilla", "albireo", "expected-loss"];

/// The limits within which cameras count as carried: at least this share of the frames is answered, at most this share
/// of the answers lacks a required detector run, and 99 % of the answers arrive within this many milliseconds (three
/// frames).
const ANSWERED: f64 = 0.99;
const DEGRADED: f64 = 0.01;
const LATEST_MS: f64 = 100.0;

/// The wait for the last answers after the last frame is sent.
const LAST_ANSWERS: Duration = Duration::from_millis(500);

/// A trial with one number of cameras under one policy.
struct Trial {
    cameras: usize,
    provider: String,
    /// The shares of the frames that were due.
    sent: f64,
    answered: f64,
    /// The shares of the answers.
    degraded: f64,
    skipped: f64,
    p50: Option<f64>,
    p99: Option<f64>,
    answers: usize,
    energy: Option<Energy>,
}

impl Trial {
    /// The reason for which this many cameras are not carried, if any.
    fn why_not(&self) -> Option<String> {
        if self.sent < ANSWERED {
            return Some(format!(
                "this machine could send only {:.1} %",
                self.sent * 100.0
            ));
        }
        if self.answered < ANSWERED {
            return Some(format!("{:.1} % answered", self.answered * 100.0));
        }
        if self.degraded > DEGRADED {
            return Some(format!("{:.1} % degraded", self.degraded * 100.0));
        }
        let p99 = self.p99.unwrap_or(f64::INFINITY);
        (p99 > LATEST_MS).then(|| format!("99 % within {p99:.0} ms"))
    }
}

/// Writes the table, with one row per model and policy.
pub(crate) async fn write(
    page: &mut Page,
    arguments: &Arguments,
    frames: &[EncodedPicture],
    card: Option<&Card>,
    engines: &Path,
) -> anyhow::Result<()> {
    let idle = match card {
        Some(card) => {
            let measuring = card.measure();
            tokio::time::sleep(Duration::from_secs(u64::from(arguments.seconds))).await;
            Some(measuring.end())
        }
        None => None,
    };
    let pictures = Arc::new(frames.to_vec());
    let mut rows = Vec::new();
    for model in arguments.camera_models()? {
        let detector = DetectorConfig {
            batch_size: batch(arguments, &model, engines),
            // The node's timeout: a frame that waits longer is of no use.
            timeout_ms: 10_000,
            ..arguments.detector(&model, Some(engines))
        };
        for policy in POLICIES {
            match most(arguments, &detector, policy, &pictures, card, engines).await {
                Ok((best, limit)) => rows.push(row(&model, policy, best.as_ref(), &limit)),
                Err(error) => {
                    let said = without_folder(format_args!("{error:#}"), &model);
                    let mut row = vec![name_of(&model), policy.to_owned(), said];
                    row.resize(12, NONE.to_owned());
                    rows.push(row);
                }
            }
        }
    }
    page.heading("Cameras at 30 frames per second");
    page.text(format!(
        "JPEG pictures of {} from one Zenoh session to one node; each trial {} s after one that does not count. Carried: {:.0} % of \
         the frames answered, at most {:.0} % without the detector that was needed, 99 % of the answers within {LATEST_MS:.0} ms of \
         the put. The number is doubled until it is too large, then the gap is halved; tried up to {}. Decoding is the processor's work, \
         so the processor may be what ends it: the last column says what was missed.",
        frames.first().map_or_else(String::new, |frame| frame.size.to_string()),
        arguments.seconds,
        ANSWERED * 100.0,
        DEGRADED * 100.0,
        arguments.most_cameras,
    ));
    page.text(match (card, idle) {
        (Some(_), Some(idle)) => format!(
            "Energy is the whole card's, measured by NVML: J/frame by the energy counter where the card has one; beside it the \
             power, looked at every 20 ms and added up, as a share of the counter (NVML's power may be a mean over a second). \
             Idle before the trials: {} W by the counter, {} W by power.",
            watts(idle.counter, idle.seconds),
            watts(idle.integrated, idle.seconds),
        ),
        _ => "Energy was **not measured**: there is no NVIDIA driver on this machine, and nothing is estimated in its place."
            .to_owned(),
    });
    page.table(
        &[
            "model",
            "policy",
            "cameras carried",
            "provider used",
            "pictures per run, at most",
            "skipped",
            "put to answer, median ms",
            "99 %",
            "W",
            "J/frame",
            "power added up / counter",
            "ended by",
        ],
        &rows,
    );
    Ok(())
}

fn watts(joules: Option<f64>, seconds: f64) -> String {
    joules.map_or_else(
        || NONE.to_owned(),
        |joules| format!("{:.1}", joules / seconds),
    )
}

fn row(model: &Path, policy: &str, best: Option<&(Trial, usize)>, limit: &str) -> Vec<String> {
    let mut row = vec![name_of(model), policy.to_owned()];
    match best {
        Some((trial, batch)) => {
            let energy = trial.energy.unwrap_or_default();
            let number = |value: Option<f64>, digits: usize| {
                value.map_or_else(|| NONE.to_owned(), |value| format!("{value:.digits$}"))
            };
            let agreement = energy.integrated.zip(energy.counter);
            row.extend([
                trial.cameras.to_string(),
                trial.provider.clone(),
                batch.to_string(),
                format!("{:.1} %", trial.skipped * 100.0),
                ms(trial.p50),
                ms(trial.p99),
                number(energy.watts(), 1),
                number(
                    energy.joules().map(|joules| joules / trial.answers as f64),
                    4,
                ),
                number(agreement.map(|(power, counter)| power / counter), 3),
            ]);
        }
        None => row.extend(std::iter::once("0".to_owned()).chain(vec![NONE.to_owned(); 8])),
    }
    row.push(limit.to_owned());
    row
}

/// Finds the largest number of cameras that is carried, with the pictures per run and the reason for the limit.
async fn most(
    arguments: &Arguments,
    detector: &DetectorConfig,
    policy: &str,
    pictures: &Arc<Vec<EncodedPicture>>,
    card: Option<&Card>,
    engines: &Path,
) -> anyhow::Result<(Option<(Trial, usize)>, String)> {
    let most = usize::from(arguments.most_cameras);
    let (mut best, mut too_many, mut limit) = (None::<(Trial, usize)>, most + 1, String::new());
    let mut cameras = 1;
    loop {
        let detector = DetectorConfig {
            batch_size: detector.batch_size.min(cameras),
            ..detector.clone()
        };
        let trial = trial(
            arguments, &detector, policy, cameras, pictures, card, engines,
        )
        .await?;
        eprintln!(
            "{policy}, {cameras} cameras: {:.1} % answered, {:.1} % skipped, 99 % within {} ms",
            trial.answered * 100.0,
            trial.skipped * 100.0,
            ms(trial.p99)
        );
        match trial.why_not() {
            Some(why_not) => {
                limit = format!("{cameras}: {why_not}");
                too_many = cameras;
            }
            None => best = Some((trial, detector.batch_size)),
        }
        let carried = best.as_ref().map_or(0, |(trial, _)| trial.cameras);
        cameras = if too_many > most && carried < most {
            (carried * 2).clamp(1, most)
        } else {
            (carried + too_many) / 2
        };
        // An eighth is precise enough.
        if carried >= most || cameras <= carried || too_many - carried <= 1 + carried / 8 {
            break;
        }
    }
    if limit.is_empty() {
        limit = format!("{most}, the most that were tried");
    }
    Ok((best, limit))
}

async fn trial(
    arguments: &Arguments,
    detector: &DetectorConfig,
    policy: &str,
    cameras: usize,
    pictures: &Arc<Vec<EncodedPicture>>,
    card: Option<&Card>,
    engines: &Path,
) -> anyhow::Result<Trial> {
    let folder = tempfile::tempdir()?;
    let mut node = Node::start(&Settings {
        detector: detector.clone(),
        policy,
        cameras,
        caches: engines,
        folder: folder.path(),
    })
    .await?;
    let provider = node.ready(folder.path()).await?;
    let node = Arc::new(node);
    let warm_up = RATE as u64;
    let measured = (RATE * f64::from(arguments.seconds)) as u64;
    let cameras_sending: Vec<_> = (0..cameras)
        .map(|camera| {
            let (node, pictures) = (Arc::clone(&node), Arc::clone(pictures));
            tokio::spawn(
                async move { node.send(camera, pictures, warm_up + measured, || false).await },
            )
        })
        .collect();
    tokio::time::sleep(Duration::from_secs(1)).await;
    let (begun, measuring) = (Instant::now(), card.map(Card::measure));
    let mut put = Vec::new();
    for camera in cameras_sending {
        put.push(camera.await??);
    }
    let took = begun.elapsed().as_secs_f64();
    let energy = measuring.map(super::card::Measuring::end);
    tokio::time::sleep(LAST_ANSWERS).await;
    let mut answers = node.answers();
    answers.retain(|answer| answer.message.seq >= warm_up);

    let count =
        |what: &dyn Fn(&Answer) -> bool| answers.iter().filter(|answer| what(answer)).count();
    let degraded = count(&|answer| answer.message.degraded) as f64;
    let skipped =
        count(&|answer| !answer.message.degraded && answer.message.state.is_skipped()) as f64;
    let times: Vec<_> = answers
        .iter()
        .filter_map(|answer| {
            let number = usize::try_from(answer.message.seq).ok()?;
            let put = put.get(answer.camera)?.get(number)?;
            Some((answer.at - *put).as_secs_f64() * 1e3)
        })
        .collect();
    let sent = measured as f64 * cameras as f64;
    let all = answers.len().max(1) as f64;
    Ok(Trial {
        cameras,
        provider,
        // Missed ticks make the run longer.
        sent: (f64::from(arguments.seconds) / took).min(1.0),
        answered: answers.len() as f64 / sent,
        degraded: degraded / all,
        skipped: skipped / all,
        p50: percentile(&times, 0.5),
        p99: percentile(&times, 0.99),
        answers: answers.len(),
        energy,
    })
}

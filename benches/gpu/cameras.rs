//! Measures how many cameras one detector carries at 30 frames per second under a policy, with the energy of each.
//! One node serves all trials of a policy, so that a trial costs its own seconds and no start.

use super::arguments::{Arguments, Policy, name_of};
use super::card::{Card, Energy, Measuring};
use super::node::{Answer, Node, RATE, Settings, Work};
use super::page::{NONE, ms, percentile};
use super::pieces::{Row, Table, TableName};
use super::stages::frames;
use albireo_vision::detector::DetectorConfig;
use albireo_vision::picture::EncodedPicture;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Cameras count as carried if at least this share of the frames that were due is on time: answered within so many
/// milliseconds (three frames), by the detector if it was needed.
const ON_TIME: f64 = 0.99;
const LATEST_MS: f64 = 100.0;

/// The number of cameras that is tried first under every policy, so that there are figures of the same work.
const TOGETHER: usize = 8;

/// The pictures in a run, if the model takes several.
const BATCH: usize = 8;

/// The time in which the answers to the last frames arrive.
const LAST_ANSWERS: Duration = Duration::from_millis(500);

/// The time kept for the end of a piece.
const TO_END: Duration = Duration::from_secs(3);

/// A trial with one number of cameras.
#[derive(Clone)]
struct Trial {
    cameras: usize,
    /// The shares of the frames that were due.
    sent: f64,
    answered: f64,
    on_time: f64,
    /// The shares of the answers.
    degraded: f64,
    skipped: f64,
    p50: Option<f64>,
    p99: Option<f64>,
    answers: usize,
    /// The pictures per run of the model.
    shared: f64,
    /// Processor time of the node per answer, in milliseconds.
    processor_ms: f64,
    energy: Option<Energy>,
}

impl Trial {
    fn is_carried(&self) -> bool {
        self.sent >= ON_TIME && self.on_time >= ON_TIME
    }

    /// What was missed, in the order in which it begins.
    fn missed(&self) -> String {
        if self.sent < ON_TIME {
            return format!("this machine could send only {:.1} %", self.sent * 100.0);
        }
        format!(
            "{:.1} % on time, {:.1} % answered, {:.1} % degraded, 99 % within {} ms",
            self.on_time * 100.0,
            self.answered * 100.0,
            self.degraded * 100.0,
            ms(self.p99)
        )
    }
}

pub(crate) fn carried_table(arguments: &Arguments) -> Table {
    Table {
        heading: "Cameras at 30 frames per second",
        text: format!(
            "JPEG pictures of the demonstration's road from one Zenoh session to one node; each trial {} s after one that does not \
             count. Carried: {:.0} % of the frames that were due are answered within {LATEST_MS:.0} ms of the put, by the detector if \
             it was needed. *Capacity* is interpolated between the last number that was carried and the first that was not, \
             to the camera at which the share falls below that; its detected frames are those that the policy does not skip. Tried \
             up to {}. Pictures are decoded by the processor, so the processor may be what ends it: the last column says what \
             was missed. Energy is the whole card's by NVML's counter, the card at rest included.",
            arguments.seconds,
            ON_TIME * 100.0,
            arguments.most_cameras,
        ),
        columns: &[
            "model",
            "policy",
            "cameras carried",
            "capacity, cameras",
            "detected frames/s",
            "skipped",
            "pictures a run",
            "put to answer, median ms",
            "99 %",
            "W",
            "J/frame",
            "processor, ms/frame",
            "ended by",
        ],
    }
}

pub(crate) fn together_table() -> Table {
    Table {
        heading: "The same cameras under each policy",
        text: format!(
            "The first trial of each row above: {TOGETHER} cameras, or as many as may be tried. The power looked at every 20 ms and \
             added up is given as a share of the counter."
        ),
        columns: &[
            "model",
            "policy",
            "cameras",
            "provider used",
            "on time",
            "skipped",
            "pictures a run, of at most",
            "put to answer, median ms",
            "99 %",
            "W",
            "J/frame",
            "processor, ms/frame",
            "answers",
            "power added up / counter",
        ],
    }
}

pub(crate) async fn measure(
    arguments: &Arguments,
    model: &Path,
    policy: &Policy,
) -> anyhow::Result<Vec<Row>> {
    let until = Instant::now() + arguments.limit() - TO_END;
    let pictures = Arc::new(frames()?);
    let folder = tempfile::tempdir()?;
    let mut bench = Bench::start(arguments, model, policy, folder.path(), &pictures).await?;
    let most = usize::from(arguments.most_cameras);
    let first = bench.trial(TOGETHER.min(most)).await?;
    let mut trials = vec![first.clone()];
    while let Some(cameras) = next(&trials, most)
        && Instant::now() + bench.takes() < until
    {
        trials.push(bench.trial(cameras).await?);
    }
    Ok(vec![
        Row {
            table: TableName::Carried,
            cells: carried(model, policy, &trials, most),
        },
        Row {
            table: TableName::Together,
            cells: together(model, policy, &first, &bench),
        },
    ])
}

/// The most cameras that were carried, and the fewest that were not.
fn bounds(trials: &[Trial]) -> (Option<&Trial>, Option<&Trial>) {
    let fewest = trials
        .iter()
        .filter(|trial| !trial.is_carried())
        .min_by_key(|trial| trial.cameras);
    let below = |trial: &&Trial| fewest.is_none_or(|fewest| trial.cameras < fewest.cameras);
    let carried = trials
        .iter()
        .filter(|trial| trial.is_carried())
        .filter(below)
        .max_by_key(|trial| trial.cameras);
    (carried, fewest)
}

/// The next number to try. With too many cameras, a node answers as many frames as it can: their share tells about
/// where the capacity lies, which a search by halves would need several trials for.
fn next(trials: &[Trial], most: usize) -> Option<usize> {
    let (carried, fewest) = bounds(trials);
    let least = carried.map_or(0, |trial| trial.cameras);
    let Some(fewest) = fewest else {
        if least >= most {
            return None;
        }
        return Some((least * 2).clamp(1, most));
    };
    // To one camera in sixteen: the share on time is not known better.
    if fewest.cameras - least <= 1 + least / 16 {
        return None;
    }
    let likely = (fewest.cameras as f64 * fewest.answered).floor() as usize;
    // A trial that says little, close to a number that was tried, is moved to the middle.
    let middle = (least + fewest.cameras) / 2;
    let is_new = likely > least && likely < fewest.cameras;
    Some(if is_new { likely } else { middle })
}

/// The number of cameras at which the share of frames on time falls below the limit, by interpolation.
fn capacity(carried: Option<&Trial>, fewest: Option<&Trial>) -> Option<f64> {
    let fewest = fewest?;
    if fewest.sent < ON_TIME {
        return None;
    }
    // No camera at all is always on time.
    let cameras = carried.map_or(0, |trial| trial.cameras);
    let on_time = carried.map_or(1.0, |trial| trial.on_time);
    let part = (on_time - ON_TIME) / (on_time - fewest.on_time);
    let part = part.clamp(0.0, 1.0);
    Some(cameras as f64 + part * (fewest.cameras - cameras) as f64)
}

fn carried(model: &Path, policy: &Policy, trials: &[Trial], most: usize) -> Vec<String> {
    let (best, fewest) = bounds(trials);
    let capacity = capacity(best, fewest);
    let ended_by = match fewest {
        Some(trial) => format!("{}: {}", trial.cameras, trial.missed()),
        None if best.is_some_and(|best| best.cameras >= most) => {
            format!("{most}, the most that are tried")
        }
        None => "the time for the piece: more were not tried".to_owned(),
    };
    let mut cells = vec![name_of(model), policy.to_string()];
    match best {
        Some(best) => {
            let at_least = match capacity {
                Some(cameras) => format!("{cameras:.1}"),
                None => format!("{} or more", best.cameras),
            };
            let detected = capacity.unwrap_or(best.cameras as f64) * RATE * (1.0 - best.skipped);
            cells.extend([best.cameras.to_string(), at_least, format!("{detected:.0}")]);
            cells.extend([percent(best.skipped), format!("{:.2}", best.shared)]);
            cells.extend(costs(best));
        }
        None => {
            cells.push("0".to_owned());
            cells.resize(12, NONE.to_owned());
        }
    }
    cells.push(ended_by);
    cells
}

fn together(model: &Path, policy: &Policy, trial: &Trial, bench: &Bench<'_>) -> Vec<String> {
    let mut cells = vec![
        name_of(model),
        policy.to_string(),
        trial.cameras.to_string(),
        bench.provider.clone(),
        percent(trial.on_time),
        percent(trial.skipped),
        format!("{:.2} of {}", trial.shared, bench.batch),
    ];
    cells.extend(costs(trial));
    cells.push(trial.answers.to_string());
    let energy = trial.energy.unwrap_or_default();
    let agreement = energy.integrated.zip(energy.counter).map(|(power, counter)| power / counter);
    cells.push(number(agreement, 3));
    cells
}

/// Time and energy of a trial: median and 99 % in milliseconds, watts, joules per frame, processor time.
fn costs(trial: &Trial) -> [String; 5] {
    let energy = trial.energy.unwrap_or_default();
    let joules = energy.joules().map(|joules| joules / trial.answers.max(1) as f64);
    [
        ms(trial.p50),
        ms(trial.p99),
        number(energy.watts(), 1),
        number(joules, 4),
        format!("{:.2}", trial.processor_ms),
    ]
}

fn percent(share: f64) -> String {
    format!("{:.1} %", share * 100.0)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| NONE.to_owned(), |value| format!("{value:.digits$}"))
}

/// A node under one policy, and the cameras that send to it.
struct Bench<'a> {
    arguments: &'a Arguments,
    node: Arc<Node>,
    pictures: Arc<Vec<EncodedPicture>>,
    card: Option<Card>,
    provider: String,
    /// The most pictures in a run.
    batch: usize,
    /// The number of each camera's next frame: a camera goes on where the trial before ended.
    next_frame: u64,
}

impl<'a> Bench<'a> {
    async fn start(
        arguments: &'a Arguments,
        model: &Path,
        policy: &Policy,
        folder: &Path,
        pictures: &Arc<Vec<EncodedPicture>>,
    ) -> anyhow::Result<Self> {
        let open = async |batch: usize| {
            let detector = DetectorConfig {
                batch_size: batch,
                // The node's timeout: a frame that waits longer is of no use.
                timeout_ms: 10_000,
                ..arguments.detector(model)
            };
            let mut node = Node::start(&Settings {
                detector,
                policy,
                cameras: arguments.most_cameras.into(),
                caches: &arguments.engines,
                folder,
            })
            .await?;
            let provider = node.ready(folder).await?;
            anyhow::Ok((node, provider, batch))
        };
        // A model that takes one picture at a time is refused with a batch.
        let (node, provider, batch) = match open(BATCH).await {
            Err(error) if error.to_string().contains("batch_size") => open(1).await?,
            other => other?,
        };
        Ok(Self {
            arguments,
            node: Arc::new(node),
            pictures: Arc::clone(pictures),
            card: Card::open(arguments.device).ok(),
            provider,
            batch,
            next_frame: 0,
        })
    }

    /// The time of one trial.
    fn takes(&self) -> Duration {
        Duration::from_secs(u64::from(self.arguments.seconds) + 1) + LAST_ANSWERS
    }

    async fn trial(&mut self, cameras: usize) -> anyhow::Result<Trial> {
        let from = self.next_frame;
        let counted = from + RATE as u64;
        let measured = (RATE * f64::from(self.arguments.seconds)) as u64;
        self.next_frame = counted + measured;
        let frames = from..self.next_frame;
        let mut sending = Vec::new();
        for camera in 0..cameras {
            let node = Arc::clone(&self.node);
            let pictures = Arc::clone(&self.pictures);
            let frames = frames.clone();
            sending.push(tokio::spawn(async move {
                node.send(camera, pictures, frames, || false).await
            }));
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
        let begun = Instant::now();
        let before = self.node.work().await?;
        let measuring = self.card.as_ref().map(Card::measure);
        let mut put = Vec::new();
        for camera in sending {
            put.push(camera.await??);
        }
        let took = begun.elapsed().as_secs_f64();
        let energy = measuring.map(Measuring::end);
        let after = self.node.work().await?;
        tokio::time::sleep(LAST_ANSWERS).await;
        let mut answers = self.node.answers();
        answers.retain(|answer| answer.message.seq >= counted);
        let answers = Answers {
            answers,
            put,
            from,
            due: measured as f64 * cameras as f64,
        };
        let trial = Trial {
            cameras,
            // Missed ticks make the run longer.
            sent: (f64::from(self.arguments.seconds) / took).min(1.0),
            energy,
            ..answers.trial(before, after)
        };
        eprintln!(
            "  {cameras} cameras: {}, {:.1} % skipped",
            trial.missed(),
            trial.skipped * 100.0
        );
        Ok(trial)
    }
}

/// The answers of one trial that count.
struct Answers {
    answers: Vec<Answer>,
    /// The time of each put, by camera and by frame number less `from`.
    put: Vec<Vec<Instant>>,
    from: u64,
    /// The number of frames that were due.
    due: f64,
}

impl Answers {
    /// The milliseconds from the put to an answer.
    fn took(&self, answer: &Answer) -> Option<f64> {
        let number = usize::try_from(answer.message.seq.checked_sub(self.from)?).ok()?;
        let put = self.put.get(answer.camera)?.get(number)?;
        Some((answer.at - *put).as_secs_f64() * 1e3)
    }

    /// The shares and times; what the sender and the card say is left open.
    fn trial(&self, before: Work, after: Work) -> Trial {
        let times: Vec<_> = self.answers.iter().filter_map(|answer| self.took(answer)).collect();
        let share = |what: &dyn Fn(&Answer) -> bool, of: f64| {
            self.answers.iter().filter(|answer| what(answer)).count() as f64 / of
        };
        let all = self.answers.len().max(1) as f64;
        let on_time = |answer: &Answer| {
            !answer.message.degraded && self.took(answer).is_some_and(|took| took <= LATEST_MS)
        };
        let skipped =
            |answer: &Answer| !answer.message.degraded && answer.message.state.is_skipped();
        Trial {
            cameras: self.put.len(),
            sent: 1.0,
            answered: self.answers.len() as f64 / self.due,
            on_time: share(&on_time, self.due),
            degraded: share(&|answer| answer.message.degraded, all),
            skipped: share(&skipped, all),
            p50: percentile(&times, 0.5),
            p99: percentile(&times, 0.99),
            answers: self.answers.len(),
            shared: (after.pictures - before.pictures) / (after.runs - before.runs).max(1.0),
            processor_ms: (after.processor_seconds - before.processor_seconds) * 1e3 / all,
            energy: None,
        }
    }
}

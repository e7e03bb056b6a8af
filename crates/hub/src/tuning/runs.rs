//! Drives rollouts and trials: asks nodes for values, brings the measurements, keeps the state in the database.

use super::members::{Millis, Observation, Order, Outcome};
use super::metric::{BeforeAfter, Figure, Figures};
use super::rollout::{
    Candidate, Command, CommandError, Measurements, PlanError, Rollout, RolloutRequest, Window,
};
use super::selector::Selector;
use super::trial::{Trial, TrialPhase, TrialPlan};
use super::tuner::{NewOrder, Tuner, text};
use crate::presence::NodeSettings;
use crate::store::tables::EventRow;
use crate::store::{ClipSums, ClipWindow, RunRow, StoreError};
use albireo_wire::{DesiredSetting, Threshold, ThresholdName};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::{BTreeMap, HashMap};

/// How long a claim holds.
const CLAIM_MS: Millis = 20_000;
/// Time between two claims.
const CLAIM_EVERY_MS: Millis = 4_000;

/// A rollout or a trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub(crate) enum Run {
    Rollout(Rollout),
    Trial(Trial),
}

/// What this hub drives.
#[derive(Debug, Default)]
pub(crate) struct Runs {
    /// By kind and number.
    running: BTreeMap<(String, i64), Active>,
    claimed_ms: Millis,
}

impl Runs {
    /// A kept run as it is now: from memory where this hub drives it.
    fn as_it_is(&self, row: RunRow) -> Result<(RunRow, Run), StoreError> {
        let run = match self.running.get(&(row.kind.clone(), row.id)) {
            Some(active) => active.run.clone(),
            None => serde_json::from_str(&row.state)?,
        };
        Ok((row, run))
    }
}

#[derive(Debug)]
struct Active {
    run: Run,
    who: String,
    why: String,
    /// It changed since it was kept.
    unsaved: bool,
}

impl Active {
    fn new(run: Run, who: String) -> Self {
        let why = match &run {
            Run::Rollout(rollout) => rollout.plan.why.clone(),
            Run::Trial(trial) => trial.plan.why.clone(),
        };
        Self {
            run,
            who,
            why,
            unsaved: false,
        }
    }
}

/// Why a rollout or trial cannot be begun or commanded.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The plan makes no sense.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The command makes no sense where the rollout is.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The database cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is none.
    #[error("there is no {kind} {id}")]
    Unknown {
        /// `rollout` or `trial`.
        kind: &'static str,
        /// Its number.
        id: i64,
    },
    /// It is not this hub's.
    #[error("the {kind} {id} is driven by another hub on the same database, or has ended")]
    Elsewhere {
        /// `rollout` or `trial`.
        kind: &'static str,
        /// Its number.
        id: i64,
    },
    /// A node takes part in one.
    #[error("the node {node} takes part in a rollout or trial: end or return that first")]
    Taken {
        /// The node.
        node: String,
    },
}

/// A node that was selected and takes no part, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LeftOut {
    /// The node.
    pub node: String,
    /// Why.
    pub why: String,
}

impl Run {
    fn due(&self) -> Vec<Order> {
        match self {
            Self::Rollout(rollout) => rollout.due(),
            Self::Trial(trial) => trial.due(),
        }
    }

    fn asked(&mut self, order: &Order, revision: u64, now: Millis) {
        match self {
            Self::Rollout(rollout) => rollout.asked(order, revision, now),
            Self::Trial(trial) => trial.asked(order, revision, now),
        }
    }

    /// Whether nothing is left to do.
    fn has_ended(&self) -> bool {
        let ended = match self {
            Self::Rollout(rollout) => rollout.phase.has_ended(),
            Self::Trial(trial) => trial.phase == TrialPhase::Done,
        };
        ended && self.due().is_empty()
    }

    fn members(&self) -> &[super::members::Member] {
        match self {
            Self::Rollout(rollout) => &rollout.members,
            Self::Trial(trial) => &trial.members,
        }
    }

    /// Where it is, for noticing that it went on.
    fn mark(&self) -> (String, usize) {
        match self {
            Self::Rollout(rollout) => (format!("{:?}", rollout.phase), rollout.record.len()),
            Self::Trial(trial) => (format!("{:?}", trial.phase), 0),
        }
    }

    pub(crate) const fn kind(&self) -> &'static str {
        match self {
            Self::Rollout(_) => "rollout",
            Self::Trial(_) => "trial",
        }
    }
}

impl Tuner {
    /// The nodes that take part in a rollout or trial, whichever hub drives it, and in which.
    pub(super) async fn taken(&self) -> Result<HashMap<String, String>, StoreError> {
        let mut taken = HashMap::new();
        for row in self.store.open_runs().await? {
            let run: Run = serde_json::from_str(&row.state)?;
            for member in run.members() {
                taken.insert(member.node.clone(), format!("{} {}", row.kind, row.id));
            }
        }
        Ok(taken)
    }

    /// Drops what is desired of a node and takes it off the database's list; its clips and its history stay.
    ///
    /// # Errors
    /// While it takes part in a rollout or trial, and when the database cannot be written.
    pub(crate) async fn forget(&self, node: &str, who: &str, now: Millis) -> Result<(), RunError> {
        // Held to the end, so that nothing begins with the node meanwhile.
        let _runs = self.runs.lock().await;
        if self.taken().await?.contains_key(node) {
            let node = node.to_owned();
            return Err(RunError::Taken { node });
        }
        let event = EventRow::new(now, "forgotten", node, json!({ "who": who }));
        let forgotten = node.to_owned();
        let written = self.store.write(move |writing| {
            writing.forget(&forgotten, now)?;
            writing.events(&[event])
        });
        written.await?;
        self.stop_following(node);
        Ok(())
    }

    /// The selected nodes that can take a value of `knob`, and those that cannot.
    fn candidates(
        &self,
        select: &Selector,
        knob: &str,
        taken: &HashMap<String, String>,
    ) -> (Vec<Candidate>, Vec<LeftOut>) {
        let (mut candidates, mut left_out) = (Vec::new(), Vec::new());
        for facts in self.fleet.all_settings() {
            if !select.selects(&facts.name, facts.labels()) {
                continue;
            }
            match able(&facts, knob, taken) {
                Ok(before) => candidates.push(Candidate {
                    node: facts.name.to_string(),
                    before,
                    reachable: facts.reachable,
                }),
                Err(why) => left_out.push(LeftOut {
                    node: facts.name.to_string(),
                    why,
                }),
            }
        }
        (candidates, left_out)
    }

    /// Begins a rollout: its number, and the nodes that were selected and take no part.
    ///
    /// # Errors
    /// When its plan makes no sense, no node can take part, or the database cannot be written.
    pub async fn begin_rollout(
        &self,
        request: RolloutRequest,
        who: &str,
        now: Millis,
    ) -> Result<(i64, Vec<LeftOut>), RunError> {
        let mut runs = self.runs.lock().await;
        let taken = self.taken().await?;
        let (candidates, mut left_out) =
            self.candidates(&request.plan.select, &request.knob.name, &taken);
        let (has_it, candidates): (Vec<_>, Vec<_>) = candidates
            .into_iter()
            .partition(|c| c.before == request.knob);
        left_out.extend(has_it.into_iter().map(|c| LeftOut {
            node: c.node,
            why: "has the value already".to_owned(),
        }));
        let seed = request.plan.seed.unwrap_or(now.unsigned_abs());
        let rollout = Rollout::begin(request, candidates, seed, who, now)?;
        let id = self
            .begin(&mut runs, Run::Rollout(rollout), who, now)
            .await?;
        Ok((id, left_out))
    }

    /// Begins a trial.
    pub(crate) async fn begin_trial(
        &self,
        plan: TrialPlan,
        who: &str,
        now: Millis,
    ) -> Result<(i64, Vec<LeftOut>), RunError> {
        plan.check()?;
        let mut runs = self.runs.lock().await;
        let taken = self.taken().await?;
        let knob = plan
            .values
            .first()
            .map_or(ThresholdName::new(), |value| value.name);
        let (candidates, left_out) = self.candidates(&plan.select, &knob, &taken);
        let seed = plan.seed.unwrap_or(now.unsigned_abs());
        let trial = Trial::begin(plan, candidates, seed, now)?;
        let id = self.begin(&mut runs, Run::Trial(trial), who, now).await?;
        Ok((id, left_out))
    }

    async fn begin(
        &self,
        runs: &mut Runs,
        run: Run,
        who: &str,
        now: Millis,
    ) -> Result<i64, RunError> {
        let state = serde_json::to_string(&run).map_err(StoreError::from)?;
        let driver = self.driver.clone();
        let (kind, by) = (run.kind(), who.to_owned());
        let id = self
            .store
            .write(move |writing| {
                writing.begin_run(kind, &by, &driver, now, now + CLAIM_MS, &state)
            })
            .await?;
        runs.running
            .insert((kind.to_owned(), id), Active::new(run, who.to_owned()));
        Ok(id)
    }

    /// A rollout or trial as it is now.
    pub(crate) async fn run(&self, kind: &'static str, id: i64) -> Result<(RunRow, Run), RunError> {
        let row = self.store.run(kind, id).await?;
        let row = row.ok_or(RunError::Unknown { kind, id })?;
        Ok(self.runs.lock().await.as_it_is(row)?)
    }

    /// The newest rollouts or trials.
    pub(crate) async fn list_runs(
        &self,
        kind: &str,
        before: i64,
        limit: i64,
    ) -> Result<Vec<(RunRow, Run)>, RunError> {
        let rows = self.store.runs(kind, before, limit).await?;
        let runs = self.runs.lock().await;
        let read = |row| Ok(runs.as_it_is(row)?);
        rows.into_iter().map(read).collect()
    }

    /// Follows a person's command on a rollout.
    ///
    /// # Errors
    /// When it makes no sense where the rollout is, another hub drives it, or the database cannot be written.
    pub async fn command_rollout(
        &self,
        id: i64,
        command: Command,
        who: &str,
        now: Millis,
    ) -> Result<(), RunError> {
        const KIND: &str = "rollout";
        let key = (KIND.to_owned(), id);
        let mut runs = self.runs.lock().await;
        if !runs.running.contains_key(&key) {
            let row = self.store.run(KIND, id).await?;
            let row = row.ok_or(RunError::Unknown { kind: KIND, id })?;
            if row.ended_ms.is_none() || command != Command::Return {
                return Err(RunError::Elsewhere { kind: KIND, id });
            }
            // The old values can return after the end too.
            let run: Run = serde_json::from_str(&row.state).map_err(StoreError::from)?;
            let taken = self.taken().await?;
            if let Some(member) = run.members().iter().find(|m| taken.contains_key(&m.node)) {
                return Err(RunError::Taken {
                    node: member.node.clone(),
                });
            }
            runs.running.insert(key.clone(), Active::new(run, row.who));
        }
        let Some(Active {
            run: Run::Rollout(rollout),
            ..
        }) = runs.running.get_mut(&key)
        else {
            return Err(RunError::Unknown { kind: KIND, id });
        };
        if rollout.phase.has_ended() {
            rollout.leave_out(|member| {
                (self.desired_value(&member.node))
                    .is_some_and(|desired| desired.revision != member.revision)
            });
        }
        if let Err(error) = rollout.command(command, who, now) {
            if rollout.phase.has_ended() {
                runs.running.remove(&key);
            }
            return Err(error.into());
        }
        let run = Run::Rollout(rollout.clone());
        let state = serde_json::to_string(&run).map_err(StoreError::from)?;
        let (driver, ended) = (self.driver.clone(), run.has_ended().then_some(now));
        // One commit: a hub that is killed must not leave a rollout that is stopped and has not ended.
        let written = self.store.write(move |writing| {
            writing.take_run(KIND, id, &driver, now + CLAIM_MS, ended, &state)
        });
        written.await?;
        if ended.is_some() {
            runs.running.remove(&key);
        }
        Ok(())
    }

    /// Ends a trial before its time, with what was measured until now.
    pub(crate) async fn end_trial(&self, id: i64, who: &str, now: Millis) -> Result<(), RunError> {
        const KIND: &str = "trial";
        let key = (KIND.to_owned(), id);
        let mut runs = self.runs.lock().await;
        let Some(Active {
            run: Run::Trial(trial),
            ..
        }) = runs.running.get_mut(&key)
        else {
            return Err(if self.store.run(KIND, id).await?.is_some() {
                RunError::Elsewhere { kind: KIND, id }
            } else {
                RunError::Unknown { kind: KIND, id }
            });
        };
        let measured = self.measure(&trial.windows(now)).await?;
        trial.end(&measured, Some(who), now);
        let run = Run::Trial(trial.clone());
        Ok(self.save(id, &run, now).await?)
    }

    /// Goes on with everything that this hub drives.
    ///
    /// # Errors
    /// When the database cannot be used: what was not done is done at the next time.
    pub async fn drive(&self, now: Millis) -> Result<(), StoreError> {
        let mut runs = self.runs.lock().await;
        if now - runs.claimed_ms >= CLAIM_EVERY_MS {
            self.claim(&mut runs, now).await?;
        }
        let keys: Vec<_> = runs.running.keys().cloned().collect();
        let mut failed = None;
        for key in keys {
            let Some(active) = runs.running.get_mut(&key) else {
                continue;
            };
            // One that cannot go on does not keep the others from it.
            match self.step(key.1, active, now).await {
                Ok(()) if active.run.has_ended() => {
                    runs.running.remove(&key);
                }
                Ok(()) => {}
                Err(error) => failed = Some(error),
            }
        }
        failed.map_or(Ok(()), Err)
    }

    /// Goes on with one and keeps what changed; what could not be kept is kept the next time.
    async fn step(&self, id: i64, active: &mut Active, now: Millis) -> Result<(), StoreError> {
        let went = self.go_on(id, active, now).await;
        // Also before an error things may have changed: nodes that were asked, for instance.
        active.unsaved |= *went.as_ref().unwrap_or(&true);
        if active.unsaved {
            self.save(id, &active.run, now).await?;
            active.unsaved = false;
        }
        went.map(drop)
    }

    async fn claim(&self, runs: &mut Runs, now: Millis) -> Result<(), StoreError> {
        let driver = self.driver.clone();
        let free = self.store.claims_free_before(now);
        let mine = self
            .store
            .write(move |writing| writing.claim_runs(&driver, free, now + CLAIM_MS))
            .await?;
        runs.claimed_ms = now;
        runs.running.retain(|key, _| mine.contains(key));
        for key in mine {
            if runs.running.contains_key(&key) {
                continue;
            }
            let Some(row) = self.store.run(&key.0, key.1).await? else {
                continue;
            };
            match serde_json::from_str::<Run>(&row.state) {
                Ok(run) => {
                    tracing::info!(kind = key.0, id = key.1, "resumed");
                    runs.running.insert(key, Active::new(run, row.who));
                }
                Err(error) => {
                    tracing::error!(%error, kind = key.0, id = key.1, "a rollout or trial cannot be read");
                }
            }
        }
        Ok(())
    }

    async fn go_on(&self, id: i64, active: &mut Active, now: Millis) -> Result<bool, StoreError> {
        let mark = active.run.mark();
        let mut changed = false;
        for order in active.run.due() {
            let nodes = order.nodes.iter().map(|node| {
                (
                    node.clone(),
                    self.fleet.settings(node).and_then(|f| f.setting()),
                )
            });
            let new = NewOrder {
                setting: DesiredSetting::Threshold(order.knob),
                nodes: nodes.collect(),
                who: active.who.clone(),
                why: if order.is_return {
                    "the old value returns".to_owned()
                } else {
                    active.why.clone()
                },
                origin: format!("{} {id}", active.run.kind()),
                selector: String::new(),
            };
            let revision = self.order(new, None, now).await?;
            active.run.asked(&order, revision, now);
            changed = true;
        }
        let look = |node: &str| {
            self.fleet
                .settings(node)
                .map(|facts| Observation::from(&facts))
        };
        match &mut active.run {
            Run::Rollout(rollout) => {
                changed |= rollout.observe(now, look);
                if let Some(request) = rollout.tick(now) {
                    let measured = async {
                        Ok(Measurements {
                            changed: self.measure(&request.changed).await?,
                            unchanged: self.measure(&request.unchanged).await?,
                        })
                    };
                    match measured.await {
                        Ok(measured) => rollout.measured(now, &measured),
                        Err(error) => {
                            rollout.not_measured(now);
                            return Err(error);
                        }
                    }
                }
            }
            Run::Trial(trial) => {
                changed |= trial.observe(now, look);
                if let Some(windows) = trial.tick(now) {
                    match self.measure(&windows).await {
                        Ok(measured) => trial.end(&measured, None, now),
                        Err(error) => {
                            trial.not_measured(now);
                            return Err(error);
                        }
                    }
                }
            }
        }
        Ok(changed || mark != active.run.mark())
    }

    async fn save(&self, id: i64, run: &Run, now: Millis) -> Result<(), StoreError> {
        let state = serde_json::to_string(run)?;
        let ended = run.has_ended().then_some(now);
        let (kind, driver) = (run.kind(), self.driver.clone());
        let written = self
            .store
            .write(move |writing| writing.save_run(kind, id, &driver, ended, &state));
        written.await
    }

    /// The clips of each node in its two windows.
    async fn measure(&self, windows: &[Window]) -> Result<Vec<BeforeAfter>, StoreError> {
        let before = (windows.iter()).map(|w| window(&w.node, w.old, w.before_ms));
        let after = (windows.iter()).map(|w| window(&w.node, w.new, w.after_ms));
        let before = self.store.clip_sums(&before.collect::<Vec<_>>()).await?;
        let after = self.store.clip_sums(&after.collect::<Vec<_>>()).await?;
        let (mut before, mut after) = (figures(before), figures(after));
        let pair = |window: &Window| BeforeAfter {
            before: before.remove(&window.node).unwrap_or_default(),
            after: after.remove(&window.node).unwrap_or_default(),
        };
        Ok(windows.iter().map(pair).collect())
    }
}

/// The value that a node has, when it can take one of `knob`; otherwise why not.
fn able(
    facts: &NodeSettings,
    knob: &str,
    taken: &HashMap<String, String>,
) -> Result<Threshold, String> {
    if let Some(other) = taken.get(&*facts.name) {
        return Err(format!("takes part in {other}"));
    }
    if let Some(target) = facts.target() {
        return Err(format!(
            "holds the target {target}, which could not be given back: switch it off first"
        ));
    }
    match facts.threshold_name() {
        None => Err("has not reported a value yet, or its policy has none".to_owned()),
        Some(name) if name.as_str() != knob => {
            Err(format!("the threshold of its policy is `{name}`"))
        }
        Some(_) => facts
            .threshold()
            .ok_or_else(|| "its cameras have different values".to_owned()),
    }
}

fn window(node: &str, knob: Threshold, [from, until]: [Millis; 2]) -> ClipWindow {
    ClipWindow {
        node: node.to_owned(),
        knob: knob.name.to_string(),
        value: text(knob),
        from_ms: from,
        until_ms: until,
    }
}

/// The sums by node as figures: measured and estimated energy apart, partly metered energy in none.
fn figures(sums: Vec<ClipSums>) -> BTreeMap<String, Figures> {
    const MEASURED: i64 = 0;
    const ESTIMATED: i64 = 2;
    let mut nodes: BTreeMap<String, Figures> = BTreeMap::new();
    for row in sums {
        let energy = match row.quality {
            MEASURED => [Some(Figure::JoulesMeasured), Some(Figure::EdpMeasured)],
            ESTIMATED => [Some(Figure::JoulesEstimated), Some(Figure::EdpEstimated)],
            _ => [None, None],
        };
        let kinds = [
            Some(Figure::SkipRate),
            energy[0],
            energy[1],
            Some(Figure::LatencyP99),
            Some(Figure::Degraded),
            Some(Figure::Recall),
            Some(Figure::Precision),
        ];
        let node = nodes.entry(row.node).or_default();
        for (kind, (count, sum)) in kinds.into_iter().zip(row.figures) {
            if let (Some(kind), 1..) = (kind, count) {
                let mean = node.entry(kind).or_default();
                mean.clips += count.unsigned_abs();
                mean.sum += sum;
            }
        }
    }
    nodes
}

/// What became of the members, by outcome.
pub(crate) fn counts(members: &[super::members::Member]) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for member in members.iter().filter(|m| m.outcome != Outcome::Untouched) {
        *counts.entry(member.outcome.name().to_owned()).or_insert(0) += 1;
    }
    counts
}

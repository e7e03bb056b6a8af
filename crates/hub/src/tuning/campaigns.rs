//! Drives rollouts and trials: asks nodes for values, brings the measurements, keeps the state in the database.

use super::fleet::NodeFacts;
use super::members::{Millis, Outcome};
use super::metric::{BeforeAfter, Figure, Figures};
use super::rollout::{
    Candidate, Command, CommandError, Measurements, Order, PlanError, Rollout, RolloutRequest,
    Window,
};
use super::selector::Selector;
use super::trial::{Trial, TrialPhase, TrialPlan};
use super::tuner::{NewOrder, Tuner, text};
use crate::store::tables::EventRow;
use crate::store::{CampaignRow, ClipSums, ClipWindow, Key, StoreError};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{DesiredSetting, Threshold, ThresholdName};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};

/// How long a hub drives what it has claimed without claiming it anew.
const CLAIM_MS: Millis = 20_000;
/// Time between two claims.
const CLAIM_EVERY_MS: Millis = 4_000;

/// A rollout or a trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub(crate) enum Campaign {
    Rollout(Rollout),
    Trial(Trial),
}

/// What this hub drives.
#[derive(Debug, Default)]
pub(crate) struct Campaigns {
    running: BTreeMap<i64, Driven>,
    claimed_ms: Millis,
}

#[derive(Debug)]
struct Driven {
    campaign: Campaign,
    who: String,
    why: String,
    /// It changed since it was kept.
    unsaved: bool,
}

impl Driven {
    fn new(campaign: Campaign, who: String) -> Self {
        let why = match &campaign {
            Campaign::Rollout(rollout) => rollout.plan.why.clone(),
            Campaign::Trial(trial) => trial.plan.why.clone(),
        };
        Self {
            campaign,
            who,
            why,
            unsaved: false,
        }
    }
}

/// Why a rollout or trial cannot be begun or commanded.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CampaignError {
    #[error(transparent)]
    Plan(#[from] PlanError),
    #[error(transparent)]
    Command(#[from] CommandError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("there is no {kind} {id}")]
    Unknown { kind: &'static str, id: i64 },
    #[error("the {kind} {id} is driven by another hub on the same database, or has ended")]
    Elsewhere { kind: &'static str, id: i64 },
    #[error("the node {node} takes part in a rollout or trial: end or return that first")]
    Taken { node: String },
}

/// A node that was selected and takes no part, and why.
#[derive(Clone, Debug, PartialEq, Serialize, utoipa::ToSchema)]
pub(crate) struct LeftOut {
    /// The node.
    pub node: String,
    /// Why.
    pub why: String,
}

impl Campaign {
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
    /// Nodes that take part in something: no second hand is laid on them.
    pub(super) fn taken(campaigns: &Campaigns) -> HashMap<String, String> {
        let mut taken = HashMap::new();
        for (id, driven) in &campaigns.running {
            for member in driven.campaign.members() {
                taken.insert(
                    member.node.clone(),
                    format!("{} {id}", driven.campaign.kind()),
                );
            }
        }
        taken
    }

    /// Drops what is desired of a node and takes it off the database's list; its clips and its history stay.
    ///
    /// # Errors
    /// While it takes part in a rollout or trial, and when the database cannot be written.
    pub(crate) async fn forget(&self, node: &str, who: &str) -> Result<(), CampaignError> {
        // Held to the end, so that nothing begins with the node meanwhile.
        let campaigns = self.campaigns.lock().await;
        if Self::taken(&campaigns).contains_key(node) {
            let node = node.to_owned();
            return Err(CampaignError::Taken { node });
        }
        let now = unix_milliseconds();
        let event = EventRow {
            at_ms: now,
            kind: "forgotten".to_owned(),
            node: Some(node.to_owned()),
            detail: serde_json::json!({ "who": who }).to_string(),
        };
        self.write(async |writing| {
            writing.forget(node, now).await?;
            writing.events(&[event]).await
        })
        .await?;
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
        for facts in self.fleet.nodes() {
            if !select.selects(&facts.name, &facts.labels()) {
                continue;
            }
            match able(&facts, knob, taken) {
                Ok(before) => candidates.push(Candidate {
                    node: facts.name,
                    before,
                    reachable: facts.reachable,
                }),
                Err(why) => left_out.push(LeftOut {
                    node: facts.name,
                    why,
                }),
            }
        }
        (candidates, left_out)
    }

    /// Begins a rollout.
    pub(crate) async fn begin_rollout(
        &self,
        request: RolloutRequest,
        who: &str,
    ) -> Result<(i64, Rollout, Vec<LeftOut>), CampaignError> {
        let mut campaigns = self.campaigns.lock().await;
        let taken = Self::taken(&campaigns);
        let (candidates, mut left_out) =
            self.candidates(&request.plan.select, &request.knob.name, &taken);
        let (has_it, candidates): (Vec<_>, Vec<_>) = candidates
            .into_iter()
            .partition(|c| c.before == request.knob);
        left_out.extend(has_it.into_iter().map(|c| LeftOut {
            node: c.node,
            why: "has the value already".to_owned(),
        }));
        let now = unix_milliseconds();
        let seed = request.plan.seed.unwrap_or(now.unsigned_abs());
        let rollout = Rollout::begin(request, candidates, seed, who, now)?;
        let id = self
            .begin(&mut campaigns, Campaign::Rollout(rollout.clone()), who, now)
            .await?;
        Ok((id, rollout, left_out))
    }

    /// Begins a trial.
    pub(crate) async fn begin_trial(
        &self,
        plan: TrialPlan,
        who: &str,
    ) -> Result<(i64, Trial, Vec<LeftOut>), CampaignError> {
        plan.check()?;
        let mut campaigns = self.campaigns.lock().await;
        let taken = Self::taken(&campaigns);
        let knob = plan
            .values
            .first()
            .map_or(ThresholdName::new(), |value| value.name);
        let (candidates, left_out) = self.candidates(&plan.select, &knob, &taken);
        let now = unix_milliseconds();
        let seed = plan.seed.unwrap_or(now.unsigned_abs());
        let trial = Trial::begin(plan, candidates, seed, now)?;
        let id = self
            .begin(&mut campaigns, Campaign::Trial(trial.clone()), who, now)
            .await?;
        Ok((id, trial, left_out))
    }

    async fn begin(
        &self,
        campaigns: &mut Campaigns,
        campaign: Campaign,
        who: &str,
        now: Millis,
    ) -> Result<i64, CampaignError> {
        let state = serde_json::to_string(&campaign).map_err(StoreError::from)?;
        let driver = self.driver.clone();
        let kind = campaign.kind();
        let id = self
            .write(async |writing| {
                writing
                    .begin_campaign(kind, who, &driver, now, now + CLAIM_MS, &state)
                    .await
            })
            .await?;
        campaigns
            .running
            .insert(id, Driven::new(campaign, who.to_owned()));
        Ok(id)
    }

    /// A rollout or trial as it is now: from memory where this hub drives it.
    pub(crate) async fn campaign(
        &self,
        kind: &'static str,
        id: i64,
    ) -> Result<(CampaignRow, Campaign), CampaignError> {
        let row = self
            .store
            .campaign(id)
            .await?
            .filter(|row| row.kind == kind);
        let row = row.ok_or(CampaignError::Unknown { kind, id })?;
        let campaigns = self.campaigns.lock().await;
        let campaign = match campaigns.running.get(&id) {
            Some(driven) => driven.campaign.clone(),
            None => serde_json::from_str(&row.state).map_err(StoreError::from)?,
        };
        Ok((row, campaign))
    }

    /// The newest rollouts or trials.
    pub(crate) async fn list_campaigns(
        &self,
        kind: &str,
        before: i64,
        limit: i64,
    ) -> Result<Vec<(CampaignRow, Campaign)>, CampaignError> {
        let rows = self.store.campaigns(kind, before, limit).await?;
        let campaigns = self.campaigns.lock().await;
        let read = |row: CampaignRow| {
            let campaign = match campaigns.running.get(&row.id) {
                Some(driven) => driven.campaign.clone(),
                None => serde_json::from_str(&row.state).map_err(StoreError::from)?,
            };
            Ok((row, campaign))
        };
        rows.into_iter().map(read).collect()
    }

    /// Follows a person's command on a rollout.
    pub(crate) async fn command_rollout(
        &self,
        id: i64,
        command: Command,
        who: &str,
    ) -> Result<Rollout, CampaignError> {
        const KIND: &str = "rollout";
        let mut campaigns = self.campaigns.lock().await;
        let now = unix_milliseconds();
        if !campaigns.running.contains_key(&id) {
            let row = self
                .store
                .campaign(id)
                .await?
                .filter(|row| row.kind == KIND);
            let row = row.ok_or(CampaignError::Unknown { kind: KIND, id })?;
            if row.ended_ms.is_none() || command != Command::Return {
                return Err(CampaignError::Elsewhere { kind: KIND, id });
            }
            // The old values can be had back after the end too.
            let campaign: Campaign = serde_json::from_str(&row.state).map_err(StoreError::from)?;
            let taken = Self::taken(&campaigns);
            if let Some(member) = campaign
                .members()
                .iter()
                .find(|m| taken.contains_key(&m.node))
            {
                return Err(CampaignError::Taken {
                    node: member.node.clone(),
                });
            }
            campaigns.running.insert(id, Driven::new(campaign, row.who));
        }
        let Some(Driven {
            campaign: Campaign::Rollout(rollout),
            ..
        }) = campaigns.running.get_mut(&id)
        else {
            return Err(CampaignError::Unknown { kind: KIND, id });
        };
        if rollout.phase.has_ended() {
            rollout.leave_out(|member| {
                (self.desired_value(&member.node))
                    .is_some_and(|desired| desired.revision != member.revision)
            });
        }
        if let Err(error) = rollout.command(command, who, now) {
            if rollout.phase.has_ended() {
                campaigns.running.remove(&id);
            }
            return Err(error.into());
        }
        let rollout = rollout.clone();
        let campaign = Campaign::Rollout(rollout.clone());
        if campaign.has_ended() {
            self.save(id, &campaign, now).await?;
            campaigns.running.remove(&id);
        } else {
            let state = serde_json::to_string(&campaign).map_err(StoreError::from)?;
            let driver = self.driver.clone();
            self.write(async |writing| {
                writing
                    .reopen_campaign(id, &driver, now + CLAIM_MS, &state)
                    .await
            })
            .await?;
        }
        Ok(rollout)
    }

    /// Ends a trial before its time, with what was measured until now.
    pub(crate) async fn end_trial(&self, id: i64, who: &str) -> Result<Trial, CampaignError> {
        const KIND: &str = "trial";
        let now = unix_milliseconds();
        let mut campaigns = self.campaigns.lock().await;
        let Some(Driven {
            campaign: Campaign::Trial(trial),
            ..
        }) = campaigns.running.get_mut(&id)
        else {
            let known = self
                .store
                .campaign(id)
                .await?
                .is_some_and(|row| row.kind == KIND);
            return Err(if known {
                CampaignError::Elsewhere { kind: KIND, id }
            } else {
                CampaignError::Unknown { kind: KIND, id }
            });
        };
        let measured = self.measure(&trial.windows(now)).await?;
        trial.end(&measured, Some(who), now);
        let trial = trial.clone();
        self.save(id, &Campaign::Trial(trial.clone()), now).await?;
        Ok(trial)
    }

    /// Goes on with everything that this hub drives.
    ///
    /// # Errors
    /// When the database cannot be used: what was not done is done at the next time.
    pub(crate) async fn drive(&self, now: Millis) -> Result<(), StoreError> {
        let mut campaigns = self.campaigns.lock().await;
        if now - campaigns.claimed_ms >= CLAIM_EVERY_MS {
            self.claim(&mut campaigns, now).await?;
        }
        let ids: Vec<i64> = campaigns.running.keys().copied().collect();
        let mut failed = None;
        for id in ids {
            let Some(driven) = campaigns.running.get_mut(&id) else {
                continue;
            };
            // One that cannot go on does not keep the others from it.
            match self.step(id, driven, now).await {
                Ok(()) if driven.campaign.has_ended() => {
                    campaigns.running.remove(&id);
                }
                Ok(()) => {}
                Err(error) => failed = Some(error),
            }
        }
        failed.map_or(Ok(()), Err)
    }

    /// Goes on with one and keeps what changed; what could not be kept is kept the next time.
    async fn step(&self, id: i64, driven: &mut Driven, now: Millis) -> Result<(), StoreError> {
        let went = self.go_on(id, driven, now).await;
        // Also before an error things may have changed: nodes that were asked, for instance.
        driven.unsaved |= *went.as_ref().unwrap_or(&true);
        if driven.unsaved {
            self.save(id, &driven.campaign, now).await?;
            driven.unsaved = false;
        }
        went.map(drop)
    }

    async fn claim(&self, campaigns: &mut Campaigns, now: Millis) -> Result<(), StoreError> {
        let driver = self.driver.clone();
        let mine = self
            .write(async |writing| writing.claim_campaigns(&driver, now, now + CLAIM_MS).await)
            .await?;
        campaigns.claimed_ms = now;
        campaigns.running.retain(|id, _| mine.contains(id));
        for id in mine {
            if campaigns.running.contains_key(&id) {
                continue;
            }
            let Some(row) = self.store.campaign(id).await? else {
                continue;
            };
            match serde_json::from_str::<Campaign>(&row.state) {
                Ok(campaign) => {
                    tracing::info!(id, kind = campaign.kind(), "going on");
                    campaigns.running.insert(id, Driven::new(campaign, row.who));
                }
                Err(error) => tracing::error!(%error, id, "a rollout or trial cannot be read"),
            }
        }
        Ok(())
    }

    async fn go_on(&self, id: i64, driven: &mut Driven, now: Millis) -> Result<bool, StoreError> {
        let mark = driven.campaign.mark();
        let mut changed = false;
        for order in driven.campaign.due() {
            let nodes = order.nodes.iter().map(|node| {
                (
                    node.clone(),
                    self.fleet.node(node).and_then(|f| f.setting()),
                )
            });
            let new = NewOrder {
                setting: DesiredSetting::Threshold(order.knob),
                nodes: nodes.collect(),
                who: driven.who.clone(),
                why: if order.is_return {
                    "the old value returns".to_owned()
                } else {
                    driven.why.clone()
                },
                origin: format!("{} {id}", driven.campaign.kind()),
                selector: String::new(),
            };
            let revision = self.order(new, None).await?;
            driven.campaign.asked(&order, revision, now);
            changed = true;
        }
        let look = |node: &str| self.fleet.node(node).map(|facts| facts.seen());
        match &mut driven.campaign {
            Campaign::Rollout(rollout) => {
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
            Campaign::Trial(trial) => {
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
        Ok(changed || mark != driven.campaign.mark())
    }

    async fn save(&self, id: i64, campaign: &Campaign, now: Millis) -> Result<(), StoreError> {
        let state = serde_json::to_string(campaign)?;
        let ended = campaign.has_ended().then_some(now);
        self.write(async |writing| writing.save_campaign(id, ended, &state).await)
            .await
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
    facts: &NodeFacts,
    knob: &str,
    taken: &HashMap<String, String>,
) -> Result<Threshold, String> {
    if let Some(other) = taken.get(&facts.name) {
        return Err(format!("takes part in {other}"));
    }
    if let Some(target) = facts.target() {
        return Err(format!(
            "holds the target {target}, which could not be given back: switch it off first"
        ));
    }
    match facts.knob_name() {
        None => Err("has not told its value yet, or its policy has none".to_owned()),
        Some(name) if name.as_str() != knob => {
            Err(format!("the threshold of its policy is `{name}`"))
        }
        Some(_) => facts
            .knob()
            .ok_or_else(|| "its cameras have different values".to_owned()),
    }
}

fn window(node: &str, knob: Threshold, [from, until]: [Millis; 2]) -> ClipWindow {
    Key([
        node.into(),
        knob.name.as_str().into(),
        text(knob).as_str().into(),
        from.into(),
        until.into(),
    ])
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
pub(crate) fn counts(members: &[super::members::Member]) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for member in members.iter().filter(|m| m.outcome != Outcome::Untouched) {
        *counts.entry(member.outcome.name()).or_insert(0) += 1;
    }
    counts
}

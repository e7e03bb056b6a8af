//! Drives rollouts and trials: gives their values, measures the clips, and stores their state in the database.

use super::member::{Member, Millis};
use super::revision::Revision;
use super::run::{Command, EndedBy, Kind, LeftOut, Run, counted_nodes};
use super::tuner::Tuner;
use crate::presence::NodeView;
use crate::store::{EventRow, StoreError};
use albireo_service::http::Problem;
use albireo_wire::{DesiredSetting, Threshold};
use axum::http::StatusCode;
use serde_json::json;
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};

/// The duration of a claim.
const CLAIM_MS: Millis = 20_000;
/// Time between two claims.
const CLAIM_EVERY_MS: Millis = 4_000;

/// Most names that are forgotten in one transaction.
const MOST_STRANGERS: usize = 500;

/// Most reasons in the answer to a request for which too few nodes can take part.
const MOST_REASONS: usize = 5;

impl Run {
    fn key(&self) -> RunKey {
        RunKey {
            kind: self.kind.name().to_owned(),
            id: self.id,
        }
    }
}

/// Identifies a rollout or trial.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RunKey {
    pub(crate) kind: String,
    pub(crate) id: i64,
}

/// The rollouts and trials that this hub drives.
#[derive(Debug, Default)]
pub(crate) struct DrivenRuns {
    running: BTreeMap<RunKey, Run>,
    claimed_ms: Millis,
}

/// The problem of a request that is not possible now.
fn conflict(detail: String) -> Problem {
    Problem::new(StatusCode::CONFLICT, detail)
}

/// The problem of a command to a rollout or trial that this hub does not drive.
fn not_driven(kind: &str, id: i64) -> Problem {
    conflict(format!(
        "the {kind} {id} is driven by another hub on the same database, or has ended"
    ))
}

impl Tuner {
    /// The nodes that take part in a rollout or trial of any hub, with its kind and number.
    pub(super) async fn taken(&self) -> Result<HashMap<String, String>, StoreError> {
        let mut taken = HashMap::new();
        for run in self.store.open_runs().await? {
            let name = format!("{} {}", run.kind.name(), run.id);
            taken.extend(run.members.into_iter().map(|member| (member.node, name.clone())));
        }
        Ok(taken)
    }

    /// Forgets a node: drops its desired setting, and removes it from the list. Its clips and its history stay.
    ///
    /// # Errors
    /// While it takes part in a rollout or trial, and when the database cannot be written.
    pub(crate) async fn forget(&self, node: &str, who: &str, now: Millis) -> Result<(), Problem> {
        // Held to the end, so that no rollout or trial begins with the node before it is forgotten.
        let _runs = self.runs.lock().await;
        if self.taken().await?.contains_key(node) {
            return Err(conflict(format!(
                "the node {node} takes part in a rollout or trial: end or return that first"
            )));
        }
        let event = EventRow::of(now, "forgotten", node, json!({ "who": who }));
        let forgotten = node.to_owned();
        self.store
            .write(move |writing| {
                writing.drop_desired(&forgotten, now)?;
                writing.forget_node(&forgotten, now)?;
                writing.insert_events(&[event])
            })
            .await?;
        self.desired.remove(node);
        self.fleet.forget(node);
        Ok(())
    }

    /// Forgets names that somebody may have invented: out of reach for a week, without a report, and without a desired
    /// setting.
    ///
    /// # Errors
    /// When the database cannot be written; the next call finds them again.
    pub(super) async fn forget_strangers(&self, now: Millis) -> Result<(), StoreError> {
        let mut names = self.fleet.strangers(MOST_STRANGERS, now);
        names.retain(|name| self.desired.get(name).is_none());
        if names.is_empty() {
            return Ok(());
        }
        let forgotten = names.clone();
        self.store
            .write(move |writing| writing.forget_strangers(&forgotten, now))
            .await?;
        for name in &names {
            self.fleet.forget(name);
        }
        Ok(())
    }

    /// Begins a rollout or trial on the selected nodes that can take part.
    ///
    /// # Errors
    /// When its plan is invalid, too few nodes can take part, or the database cannot be written.
    pub async fn begin(&self, kind: Kind, who: &str, now: Millis) -> Result<Run, Problem> {
        let mut runs = self.runs.lock().await;
        let taken = self.taken().await?;
        let mut candidates = Vec::new();
        let mut left_out = Vec::new();
        let select = &kind.basics().select;
        for node in self.fleet.views(|node| select.selects(&node.node, node.labels())) {
            let reachable = node.is_reachable();
            match able(&node, &kind, &taken) {
                Ok(before) => candidates.push(Member::new(node.node, before, reachable)),
                Err(why) => left_out.push(LeftOut {
                    node: node.node,
                    why,
                }),
            }
        }
        let seed = kind.basics().seed.unwrap_or(now.unsigned_abs());
        let is_nobody_selected = candidates.is_empty() && left_out.is_empty();
        let mut run = match Run::begin(kind, candidates, seed, who, now) {
            Ok(run) => run,
            Err(mut error) => {
                let has_too_few = error.starts_with("select: ");
                if has_too_few && is_nobody_selected {
                    error = "select: no node is selected".to_owned();
                } else if has_too_few {
                    // Why the others are left out shows what to do.
                    error += &counted_reasons(&left_out);
                }
                return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, error));
            }
        };
        // It is new, so no other hub drives it.
        self.save(&mut run, now).await?;
        runs.running.insert(run.key(), run.clone());
        run.left_out = left_out;
        Ok(run)
    }

    /// A rollout or trial, of any hub, with its record and its nodes.
    ///
    /// # Errors
    /// When there is none with that number, or the database cannot be read.
    pub(crate) async fn run(&self, kind: &str, id: i64) -> Result<Run, Problem> {
        let run = self.store.run(kind, id).await?;
        run.ok_or_else(|| Problem::new(StatusCode::NOT_FOUND, format!("there is no {kind} {id}")))
    }

    /// Executes a command on a rollout; a trial knows only the return of its values, and has the measurements until now. A
    /// rollout that has ended can still be returned, without the nodes that were changed since.
    ///
    /// # Errors
    /// When it is not possible in its phase, another hub drives it, or the database cannot be used.
    pub async fn command(
        &self,
        kind: &str,
        id: i64,
        command: Command,
        who: &str,
        now: Millis,
    ) -> Result<(), Problem> {
        let mut runs = self.runs.lock().await;
        let mut run = self.run(kind, id).await?;
        let is_rollout = matches!(run.kind, Kind::Rollout { .. });
        if let Some(driven) = runs.running.get(&run.key()) {
            run = driven.clone();
        } else if is_rollout && command == Command::Return && self.claim_ended(run.key()).await? {
            // Once more, because another hub may have returned it before the claim.
            run = self.run(kind, id).await?;
            let taken = self.taken().await?;
            run.leave_out(|member| {
                let was_changed_since = match self.desired.get(&member.node) {
                    Some(desired) => desired.given.revision != member.given.revision,
                    None => false,
                };
                was_changed_since || taken.contains_key(&member.node)
            });
        } else {
            return Err(not_driven(kind, id));
        }
        if is_rollout {
            run.command(command, who, now).map_err(conflict)?;
        } else {
            let found = self.store.measure(&run.windows(now)).await?;
            run.end_trial(&found, EndedBy::Person(who), now);
        }
        // One commit: a hub that is killed must not leave a rollout that is stopped and has not ended.
        let is_stored = self.save(&mut run, now).await?;
        if is_stored && run.ended_ms.is_none() {
            runs.running.insert(run.key(), run);
        } else {
            runs.running.remove(&run.key());
        }
        if !is_stored {
            return Err(not_driven(kind, id));
        }
        Ok(())
    }

    /// Claims a rollout or trial that has ended; returns false if it has not.
    async fn claim_ended(&self, key: RunKey) -> Result<bool, StoreError> {
        let driver = self.driver.clone();
        self.store.write(move |writing| writing.claim_ended_run(&key, &driver)).await
    }

    /// Advances everything that this hub drives.
    ///
    /// # Errors
    /// When the database cannot be used; the next call does what was left.
    pub async fn drive(&self, now: Millis) -> Result<(), StoreError> {
        let mut runs = self.runs.lock().await;
        if now - runs.claimed_ms >= CLAIM_EVERY_MS {
            self.claim(&mut runs, now).await?;
        }
        let mut result = Ok(());
        let mut lost = Vec::new();
        for (key, run) in &mut runs.running {
            // A failed run does not stop the others; its progress is saved.
            let advanced = self.advance(run, now).await;
            if advanced.is_err() {
                result = advanced;
            }
            if !run.unsaved {
                continue;
            }
            match self.save(run, now).await {
                Ok(true) => {}
                Ok(false) => lost.push(key.clone()),
                Err(error) => result = Err(error),
            }
        }
        runs.running.retain(|key, run| {
            let goes_on = run.unsaved || run.ended_ms.is_none();
            goes_on && !lost.contains(key)
        });
        result
    }

    async fn claim(&self, runs: &mut DrivenRuns, now: Millis) -> Result<(), StoreError> {
        let driver = self.driver.clone();
        let mine = self
            .store
            .write(move |writing| writing.claim_runs(&driver, now, now + CLAIM_MS))
            .await?;
        runs.claimed_ms = now;
        runs.running.retain(|key, _| mine.contains(key));
        for key in mine {
            if runs.running.contains_key(&key) {
                continue;
            }
            if let Some(run) = self.store.run(&key.kind, key.id).await? {
                tracing::info!(kind = key.kind, id = key.id, "resumed");
                runs.running.insert(key, run);
            }
        }
        Ok(())
    }

    /// Advances one run.
    async fn advance(&self, run: &mut Run, now: Millis) -> Result<(), StoreError> {
        for due in run.due() {
            let revision = Revision {
                number: None,
                at_ms: now,
                who: run.who.clone(),
                // While old values return: why they do.
                why: match run.reason.as_str() {
                    "" => run.kind.basics().why.clone(),
                    reason => reason.to_owned(),
                },
                origin: format!("{} {}", run.kind.name(), run.id),
                selector: String::new(),
                setting: DesiredSetting::Threshold(due.threshold),
                counts: BTreeMap::new(),
                nodes: Vec::new(),
            };
            let number = self.give(revision, due.nodes.clone()).await?;
            run.given(&due, number, now);
        }
        run.observe(now, |node| self.fleet.view(node));
        if let Some(windows) = run.tick(now) {
            match self.store.measure(&windows).await {
                Ok(found) => run.measured(&found, now),
                Err(error) => {
                    run.not_measured(now);
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    /// Stores a run, with the time of its end. Returns false, and stores nothing, if another hub drives it now.
    async fn save(&self, run: &mut Run, now: Millis) -> Result<bool, StoreError> {
        let has_ended = run.phase.has_ended() && run.due().is_empty();
        run.ended_ms = if has_ended {
            Some(run.ended_ms.unwrap_or(now))
        } else {
            None
        };
        run.count_stages();
        let row = run.clone();
        let driver = self.driver.clone();
        let stored = self
            .store
            .write(move |writing| writing.save_run(row, &driver, now + CLAIM_MS))
            .await?;
        let Some(id) = stored else {
            tracing::warn!(
                kind = run.kind.name(),
                id = run.id,
                "another hub drives it now"
            );
            return Ok(false);
        };
        run.id = id;
        run.unsaved = false;
        Ok(true)
    }
}

/// Why nodes are left out, each reason once with the number of its nodes, the most frequent first.
fn counted_reasons(left_out: &[LeftOut]) -> String {
    if left_out.is_empty() {
        return "; no other node is selected".to_owned();
    }
    let mut counts = BTreeMap::<&str, usize>::new();
    for one in left_out {
        *counts.entry(one.why.as_str()).or_default() += 1;
    }
    let mut reasons: Vec<(&str, usize)> = counts.into_iter().collect();
    reasons.sort_by_key(|(_, nodes)| Reverse(*nodes));
    let mut shown = Vec::new();
    for (why, count) in reasons.iter().take(MOST_REASONS) {
        shown.push(format!("{} ({why})", counted_nodes(*count)));
    }
    format!("; left out: {}", shown.join(", "))
}

/// The present value of a node that can take part; else the reason that it cannot.
fn able(
    node: &NodeView,
    kind: &Kind,
    taken: &HashMap<String, String>,
) -> Result<Threshold, String> {
    if let Some(other) = taken.get(&node.node) {
        return Err(format!("takes part in {other}"));
    }
    if matches!(kind, Kind::Trial { .. }) && !node.is_reachable() {
        return Err("is out of reach".to_owned());
    }
    if let Some(target) = node.target() {
        return Err(format!(
            "holds the target {target}, which could not be given back: switch it off first"
        ));
    }
    if node.threshold_name().is_none() {
        return Err("has not reported a value yet, or its policy has none".to_owned());
    }
    let value = match kind {
        Kind::Rollout { to, .. } => Some(to),
        Kind::Trial { plan } => plan.values.first(),
    };
    if let Some(why) = value.and_then(|value| node.unable(DesiredSetting::Threshold(*value))) {
        return Err(why);
    }
    let Some(value) = node.threshold() else {
        return Err("its cameras have different values".to_owned());
    };
    if let Kind::Rollout { to, .. } = kind
        && value == *to
    {
        return Err("has the value already".to_owned());
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_are_left_out_are_counted_by_the_reason() {
        let left_out = |node: &str, why: &str| LeftOut {
            node: node.to_owned(),
            why: why.to_owned(),
        };
        let several = [
            left_out("cam-1", "takes part in rollout 2"),
            left_out("cam-2", "has the value already"),
            left_out("cam-3", "has the value already"),
        ];
        let expected =
            "; left out: 2 nodes (has the value already), 1 node (takes part in rollout 2)";
        assert_eq!(counted_reasons(&several), expected);
        assert_eq!(counted_reasons(&[]), "; no other node is selected");
    }
}

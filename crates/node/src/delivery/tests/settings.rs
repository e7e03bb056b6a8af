//! Simulates settings sent from a hub to nodes: real desired settings, rollouts, trials and files over a faulty network.

mod hub;
mod node;

use super::timeline::{HOUR, Payload, SECOND, Timeline, folder};
use super::{Output, holds};
use albireo_hub::tuning::gate::Gate;
use albireo_hub::tuning::plan::{Basics, OnFailure, RolloutPlan, TrialPlan};
use albireo_hub::tuning::run::{Command, Kind};
use albireo_hub::tuning::selector::Selector;
use albireo_wire::{DesiredSetting, Target, Threshold};
use hub::Hub;
use node::{Node, Taken};
use std::collections::BTreeMap;
use std::rc::Rc;
use tempfile::TempDir;

/// Once nothing fails any more, every setting is answered and every rollout and trial has ended within this time.
const SETTLED_WITHIN: i64 = 4 * HOUR;
const TICK: i64 = 5 * SECOND;

/// Two more than the fewest that a trial takes.
const FEWEST_NODES_WITH_TRIALS: u64 = 18;
const FEWEST_NODES: u64 = 2;

const FAULTS: [&str; 9] = [
    "node loses power",
    "node's state is restored",
    "node is far away",
    "hub is killed",
    "hub is killed at a commit",
    "hub's disk is full",
    "hub is put back from a backup",
    "network is cut",
    "somebody changes a threshold at a node",
];

#[derive(Clone, Debug)]
enum Event {
    /// A node checks what it has to send.
    Poll(usize),
    Status {
        node: usize,
        payload: Payload<Vec<u8>>,
    },
    Notice(usize),
    /// A node asks for its desired setting; the number of the question tells its answer from an older one.
    Pull {
        node: usize,
        question: u64,
    },
    Pulled {
        node: usize,
        question: u64,
        /// `None` if no answer came in time.
        answer: Option<Payload<Vec<u8>>>,
    },
    NodeOn(usize),
    HubOn,
    HubDiskFree,
    /// The hub processes what nodes reported.
    Tick,
    Set,
    Rollout,
    Command,
    /// Targets are switched off, so that a trial can begin soon.
    PrepareTrial,
    Trial,
    EndTrial,
    KeepNode(usize),
    BackUp,
    Fault,
    End,
}

pub(super) struct Settings {
    time: Timeline<Event>,
    end_ms: i64,
    nodes: Vec<Node>,
    hub: Hub,
    /// The number of values that were given.
    values_given: u64,
    /// What each node accepted, by revision.
    taken: BTreeMap<(usize, u64), DesiredSetting>,
    /// The highest revision that was given, whatever the hub forgot since.
    highest: u64,
    /// When the hub was last put back from a backup.
    restored_ms: Option<i64>,
    _folder: TempDir,
}

impl Settings {
    fn new(seed: u64, output: Output) -> Self {
        let folder = folder();
        let mut time = Timeline::new(seed, output);
        // A trial takes many nodes, and a run with so many takes long.
        let has_trials = time.chance(100);
        let longest = if has_trials { HOUR / 2 } else { HOUR };
        let end_ms = time.between(HOUR / 4, longest);
        let fewest_nodes = if has_trials {
            FEWEST_NODES_WITH_TRIALS
        } else {
            FEWEST_NODES
        };
        let many = fewest_nodes + time.below(3);
        let nodes = (0..many).map(|at| Node::new(format!("node-{at}"), folder.path()));
        let mut world = Self {
            end_ms,
            nodes: nodes.collect(),
            hub: Hub::new(folder.path()),
            values_given: 0,
            taken: BTreeMap::new(),
            highest: 0,
            restored_ms: None,
            _folder: folder,
            time,
        };
        world.time.after(0, Event::HubOn);
        world.time.after(TICK, Event::Tick);
        for at in 0..world.nodes.len() {
            world.time.after(0, Event::NodeOn(at));
        }
        // The most times that each of them happens.
        let always = [(6, Event::Set), (10, Event::Fault), (2, Event::BackUp)];
        let runs = if has_trials {
            [(6, Event::PrepareTrial), (3, Event::EndTrial)]
        } else {
            [(4, Event::Rollout), (5, Event::Command)]
        };
        for (most, event) in always.into_iter().chain(runs) {
            for _ in 0..=world.time.below(most) {
                world.time.sometime(10 * SECOND, end_ms, event.clone());
            }
        }
        for at in 0..world.nodes.len() {
            world.time.sometime(0, end_ms, Event::KeepNode(at));
        }
        world.time.after(end_ms, Event::End);
        world
    }

    pub(super) fn run(seed: u64, output: Output) -> String {
        let mut world = Self::new(seed, output);
        loop {
            let event = world.time.next();
            let is_tick = matches!(event, Event::Tick);
            world.handle(event);
            if world.time.is_calm && is_tick {
                let wrong = world.wrong();
                if wrong.is_empty() {
                    // Asked of the oracle once per seed; the assertion below says what is wrong with one that never gets here.
                    holds("no change and no return is forgotten", true, String::new);
                    return world.time.trace();
                }
                let is_late = world.time.now_ms > world.end_ms + SETTLED_WITHIN;
                assert!(!is_late, "{}", wrong.join("; "));
            }
        }
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Poll(at) => self.poll(at),
            Event::Status { node, payload } => {
                let now = self.time.now();
                let needs_full_status = self.hub.hear(&self.nodes[node].name, &payload.0, now);
                if needs_full_status {
                    self.time.send(&Event::Notice(node));
                }
            }
            Event::Notice(at) => self.nodes[at].notice(),
            Event::Pull { node, question } => {
                if let Some(answer) = self.hub.answer(&self.nodes[node].name) {
                    self.highest = self.highest.max(self.hub.highest_revision());
                    self.time.send(&Event::Pulled {
                        node,
                        question,
                        answer: Some(Payload(Rc::new(answer))),
                    });
                }
            }
            Event::Pulled {
                node,
                question,
                answer,
            } => {
                let bytes = answer.as_ref().map(|answer| answer.0.as_slice());
                self.pulled(node, question, bytes);
            }
            Event::NodeOn(at) => self.node_on(at),
            Event::HubOn => {
                let is_on = self.hub.switch_on(self.time.now());
                if !is_on {
                    self.time.after(5 * SECOND, Event::HubOn);
                }
            }
            Event::HubDiskFree => self.hub.file.free(),
            Event::Tick => {
                self.hub.tick(self.time.now());
                self.notices();
                self.time.after(TICK, Event::Tick);
            }
            Event::Set => self.set_one(),
            Event::Rollout => self.rollout(),
            Event::Command => {
                let command = self.time.one_of(&Command::ALL);
                let which = self.time.random();
                self.hub.command(which, command, self.time.now());
                self.notices();
            }
            Event::PrepareTrial => {
                let all = self.all();
                let off = DesiredSetting::Target(None);
                self.hub.set(&all, off, self.time.now());
                self.notices();
                self.time.after(60 * SECOND, Event::Trial);
            }
            Event::Trial => self.trial(),
            Event::EndTrial => {
                let which = self.time.random();
                self.hub.end_trial(which, self.time.now());
                self.notices();
            }
            Event::KeepNode(at) => self.nodes[at].keep_state(),
            Event::BackUp => self.hub.file.back_up(),
            Event::Fault => self.fault(),
            Event::End => self.heal(),
        }
    }

    fn node_on(&mut self, at: usize) {
        if !self.nodes[at].is_on() {
            let now = self.time.now();
            let random = self.time.random();
            self.nodes[at].switch_on(now, random);
            // A poll that was planned before the node went off goes on beside this one. It does no harm: a node that is
            // polled more often sends nothing before it is due.
            self.time.after(0, Event::Poll(at));
        }
    }

    fn poll(&mut self, at: usize) {
        let now = self.time.now();
        let question = self.time.number();
        let Some(next) = self.nodes[at].poll(question, now) else {
            return;
        };
        if let Some(status) = next.status {
            self.time.send(&Event::Status {
                node: at,
                payload: Payload(Rc::new(status)),
            });
        }
        if next.pulls {
            self.time.send(&Event::Pull { node: at, question });
            let unanswered = Event::Pulled {
                node: at,
                question,
                answer: None,
            };
            self.time.after(10 * SECOND, unanswered);
        }
        // Of many nodes each is polled less often, so that a run does not take longer.
        let longest_pause = 5 * SECOND * self.nodes.len() as i64 / 4;
        self.time.sometime(SECOND, longest_pause, Event::Poll(at));
    }

    fn pulled(&mut self, at: usize, question: u64, answer: Option<&[u8]>) {
        let now = self.time.now();
        let before = self.nodes[at].state();
        let Some(taken) = self.nodes[at].conclude(question, answer, now) else {
            return;
        };
        self.time.note(&taken);
        let Taken { revision, setting } = taken;
        let highest = self.highest;
        holds(
            "no node has a revision that no hub gave",
            revision <= highest,
            || format!("revision {revision} above {highest}"),
        );
        let known = *self.taken.entry((at, revision)).or_insert(setting);
        holds(
            "a revision stands for one setting",
            known == setting,
            || format!("revision {revision} twice at node {at}"),
        );
        if self.time.unlucky(30) {
            // What was taken is written as a whole, or not at all.
            self.node_crash(at);
            if self.time.below(3) == 0 {
                self.nodes[at].put_state(before);
            }
        }
    }

    fn notices(&mut self) {
        for node in self.hub.notices() {
            let at = self.nodes.iter().position(|one| one.name == node);
            self.time.send(&Event::Notice(at.unwrap()));
        }
    }

    /// A value not given before; some are out of range.
    fn value(&mut self) -> f64 {
        self.values_given += 1;
        let given = self.values_given as f64;
        if self.time.chance(100) {
            return 2.0 + given;
        }
        1e-3 + given * 1e-4
    }

    /// A target or a threshold, or that there is no target.
    fn setting(&mut self) -> DesiredSetting {
        let value = self.value();
        match self.time.below(6) {
            0 => DesiredSetting::Target(None),
            1 | 2 => DesiredSetting::Target(Some(Target::SkipRate(10.0 * value))),
            _ => DesiredSetting::Threshold(Threshold::new("u", value)),
        }
    }

    fn all(&self) -> Vec<String> {
        self.nodes.iter().map(|node| node.name.clone()).collect()
    }

    fn some(&mut self) -> Vec<String> {
        let mut names = Vec::new();
        for node in &self.nodes {
            if self.time.chance(700) {
                names.push(node.name.clone());
            }
        }
        if names.is_empty() {
            names.push(self.nodes[0].name.clone());
        }
        names
    }

    fn set_one(&mut self) {
        let names = self.some();
        let setting = self.setting();
        self.time.note(&format!("{setting:?} for {names:?}"));
        self.hub.set(&names, setting, self.time.now());
        self.notices();
    }

    fn rollout(&mut self) {
        let names = self.some();
        let value = self.value();
        let seed = self.time.random();
        let mut seconds = || self.time.between(10, 300) as f64;
        let soak_s = seconds();
        let patience_s = seconds();
        let apply_within_s = seconds();
        let held_for_s = seconds();
        let on_failure = if self.time.chance(300) {
            OnFailure::Hold
        } else {
            OnFailure::Return
        };
        let passes = self.time.chance(500);
        let mut gates = Gate::defaults();
        if passes {
            // Nothing is measured, so only rollouts that need no measurement pass.
            gates.retain(|gate| gate.where_measured);
        }
        let plan = RolloutPlan {
            basics: Basics {
                select: Selector::new(&names).unwrap(),
                apply_within_s,
                seed: Some(seed),
                ..Basics::default()
            },
            stages: ["1", "all"].map(str::to_owned).to_vec(),
            soak_s,
            patience_s,
            held_for_s,
            offline_deadline_s: 600.0,
            gates,
            fewest_applied: 0.5,
            on_failure,
        };
        let to = Threshold::new("u", value);
        self.begin(Kind::Rollout { to, plan });
    }

    fn trial(&mut self) {
        let duration_s = self.time.between(10, 300) as f64;
        let apply_within_s = self.time.between(10, 300) as f64;
        let values = [self.value(), self.value()].map(|value| Threshold::new("u", value));
        let basics = Basics {
            select: Selector::new(&self.all()).unwrap(),
            apply_within_s,
            seed: Some(self.time.random()),
            ..Basics::default()
        };
        let plan = TrialPlan {
            basics,
            values: values.to_vec(),
            duration_s,
        };
        self.begin(Kind::Trial { plan });
    }

    fn begin(&mut self, kind: Kind) {
        self.time.note(&kind);
        self.hub.begin(kind, self.time.now());
        self.notices();
    }

    fn node_crash(&mut self, at: usize) {
        if self.nodes[at].is_on() {
            self.nodes[at].crash();
            self.time.sometime(SECOND, HOUR / 6, Event::NodeOn(at));
        }
    }

    /// Kills the hub, which returns after at least `least_ms`.
    fn hub_crash(&mut self, least_ms: i64) {
        if self.hub.is_on() {
            self.hub.crash();
            self.time.sometime(least_ms, HOUR / 6, Event::HubOn);
        }
    }

    fn fault(&mut self) {
        let at = self.time.below(self.nodes.len() as u64) as usize;
        let fault = self.time.one_of(&FAULTS);
        let lasts = self.time.between(SECOND, HOUR / 6);
        self.time.note(&format!("{fault} (node {at})"));
        match fault {
            "node loses power" => self.node_crash(at),
            "node's state is restored" => {
                if let Some(state) = self.nodes[at].kept_state.clone() {
                    self.node_crash(at);
                    self.nodes[at].put_state(Some(state));
                    self.taken.retain(|(node, _), _| *node != at);
                }
            }
            "node is far away" => {
                // The node returns after the longest deadline of a rollout.
                if self.nodes[at].is_on() {
                    self.nodes[at].crash();
                    self.time.after(HOUR / 2, Event::NodeOn(at));
                }
            }
            "hub is killed" => self.hub_crash(SECOND),
            "hub is killed at a commit" => {
                // One number for what is done and for where the log is cut: what is done uses little of it.
                let random = self.time.random();
                let work = self.time.below(4);
                let names = self.some();
                let setting = self.setting();
                let command = self.time.one_of(&Command::ALL);
                let now = self.time.now();
                let before = self.hub.file.read();
                match work {
                    0 => self.hub.set(&names, setting, now),
                    1 => self.hub.command(random, command, now),
                    2 => self.hub.end_trial(random, now),
                    _ => self.hub.tick(now),
                }
                let image = self.hub.image_at_a_commit(before, random);
                self.hub_crash(SECOND);
                if let Some(image) = image {
                    self.hub.file.restore(&image);
                }
            }
            "hub's disk is full" => {
                self.hub.file.fill();
                self.time.after(lasts, Event::HubDiskFree);
            }
            "hub is put back from a backup" => {
                if let Some(backup) = self.hub.file.backup.clone()
                    && self.hub.is_on()
                {
                    // Revisions follow the clock and may be a few seconds ahead of it. After a minute the clock has passed
                    // those that the lost database gave, so that none is given a second time.
                    self.hub_crash(60 * SECOND);
                    self.hub.file.free();
                    self.hub.file.restore(&backup);
                    self.restored_ms = Some(self.time.now_ms);
                }
            }
            "network is cut" => self.time.cut_until_ms = self.time.now_ms + lasts,
            "somebody changes a threshold at a node" => {
                let value = self.value();
                self.nodes[at].set_by_hand(value);
            }
            _ => unreachable!("{fault}"),
        }
    }

    fn heal(&mut self) {
        self.time.calm_down();
        self.hub.file.free();
        let now = self.time.now();
        let is_on = self.hub.switch_on(now);
        assert!(is_on, "the hub's database opens once its disk has room");
        self.hub.tick(now);
        for at in 0..self.nodes.len() {
            self.node_on(at);
        }
        for which in 0..self.hub.last("rollout") {
            self.hub.command(which, Command::Resume, now);
        }
    }

    /// Everything that is wrong, or not done yet.
    fn wrong(&self) -> Vec<String> {
        let mut wrong = self.hub.unfinished();
        for (at, node) in self.nodes.iter().enumerate() {
            let Some(desired) = self.hub.desired(&node.name) else {
                continue;
            };
            let revision = node.revision();
            let setting = desired.setting;
            // What the hub forgot with its database may be in force; a setting given since must not be skipped.
            let is_newer = revision > desired.revision;
            let is_before_restore =
                self.restored_ms.is_some_and(|restored_ms| desired.at_ms <= restored_ms);
            let is_forgotten = is_newer && is_before_restore;
            let is_overruled = revision == desired.revision && node.deviates(setting);
            if !is_forgotten && !is_overruled && !node.has(setting) {
                let shown = node.shown();
                wrong.push(format!("node {at} has {shown}, but {desired:?} is desired"));
            }
        }
        wrong
    }
}
